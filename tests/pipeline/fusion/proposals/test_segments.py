import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.settings.detect import ClusterConfig
from pipeline.fusion.proposals.frustums import Expected, FrustumPoints, Segments, choose_segments

CONFIG = ClusterConfig()


def wall(x: float, *, low: float, high: float, count: int = 40, top: float = 1.5) -> F64:
    """Points of a surface across the view, 10 m wide in all: `low` and `high` are shares of that."""
    y, z = np.meshgrid(np.linspace(low, high, count) * 10, np.linspace(0.3, top, 4))
    return np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])


def choose(
    *frustums: list[F64], front_m: float = 10.0, std_m: float = 1.0, min_points: int = 4, gap: float = 0.0
) -> Segments:
    """What is chosen in frustums whose box is 10 m wide and 1.5 m high."""
    clouds = [np.concatenate([np.zeros((0, 3)), *parts]) for parts in frustums]
    xyz = np.concatenate([np.zeros((0, 3)), *clouds])
    group = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    found = FrustumPoints(
        np.arange(len(xyz)), group, xyz[:, 1] / 10, 1 - xyz[:, 2] / 1.5, np.ascontiguousarray(xyz[:, 0])
    )
    n = len(clouds)
    expected = Expected(np.full(n, front_m), np.full(n, std_m), np.full(n, 5.0), np.full(n, 0.2), np.full(n, gap))
    return choose_segments(xyz.astype(np.float32), found, np.full(len(xyz), 0.6), expected, CONFIG, min_points)


def rows(segments: Segments) -> list[list[int]]:
    return [sorted(part.tolist()) for part in np.split(segments.points, segments.starts[1:])][: len(segments.group)]


OBJECT = wall(10.0, low=0.1, high=0.9)


def test_neither_what_stands_before_it_nor_what_is_behind() -> None:
    post, house = wall(7.0, low=0.4, high=0.45, count=3), wall(13.0, low=0.0, high=1.0)
    found = choose([post, OBJECT, house])
    assert rows(found) == [list(range(len(post), len(post) + len(OBJECT)))]


def test_what_is_not_where_the_object_should_be_is_not_it() -> None:
    assert len(choose([wall(20.0, low=0.0, high=1.0)]).group) == 0
    assert len(choose([wall(20.0, low=0.0, high=1.0)], std_m=4.0).group) == 1


def test_a_strip_of_the_box_is_not_its_object() -> None:
    assert len(choose([wall(10.0, low=0.4, high=0.6)]).group) == 0


def test_one_beam_is_enough_where_beams_are_far_apart() -> None:
    line = wall(10.0, low=0.1, high=0.9)[:40]
    assert np.ptp(line[:, 2]) == 0
    assert len(choose([line]).group) == 0
    assert len(choose([line], gap=0.3).group) == 1
    assert len(choose([line[:5]], gap=0.3).group) == 0, "not as wide as the 2D box"


def test_few_points_are_noise() -> None:
    four = np.array([[10.0, 2.0 + 0.3 * k, 0.5 * k] for k in range(4)]) * [1, 3, 1]
    dense = choose([four * [1, 0.3, 1] + [0, 2, 0]], min_points=5)
    assert len(dense.group) == 0


def test_long_segments_end_where_the_class_does() -> None:
    x = np.arange(9.0, 30.0, 0.2)
    hedge = np.column_stack([x, 5 + 0 * x, np.tile([0.4, 0.9, 1.4], 35)[: len(x)]])
    found = choose([np.concatenate([wall(9.0, low=0.1, high=0.9), hedge])])
    cloud = np.concatenate([wall(9.0, low=0.1, high=0.9), hedge])
    assert cloud[found.points, 0].max() <= 9.0 + 5.0 + 1e-6


def test_each_frustum_has_its_own() -> None:
    shifted, behind = OBJECT + np.array([0.5, 0, 0]), OBJECT + np.array([3.0, 0, 0])
    found = choose([OBJECT], [], [shifted, behind])
    assert found.group.tolist() == [0, 2]
    assert rows(found) == [list(range(len(OBJECT))), list(range(len(OBJECT), 2 * len(OBJECT)))]
    assert (found.worth <= 0).all()


def test_order_of_points_does_not_matter() -> None:
    cloud = np.concatenate([OBJECT, wall(13.0, low=0.0, high=1.0), wall(7.0, low=0.3, high=0.6)])
    order = np.random.default_rng(0).permutation(len(cloud))
    one, other = choose([cloud]), choose([cloud[order]])
    assert rows(one) == [sorted(order[other.points].tolist())]
    np.testing.assert_array_equal(one.worth, other.worth)


def test_nothing() -> None:
    for found in (choose(), choose([]), choose([], [])):
        assert len(found.group) == len(found.points) == len(found.starts) == 0
