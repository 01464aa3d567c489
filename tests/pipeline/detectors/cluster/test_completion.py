import numpy as np
import pytest

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.axes import Axes
from lidcam.pipeline.detectors.cluster.completion import CompletedBoxes, Directions, Kinds, complete_boxes
from lidcam.pipeline.detectors.cluster.lshape import Rectangles

PRIORS = Config().classes
KINDS = Kinds.of(PRIORS)
CAR, PEDESTRIAN, BICYCLE, TRUCK = range(4)
LENGTH, WIDTH, HEIGHT = PRIORS[CAR].size_m
TALL = PRIORS[PEDESTRIAN].size_m[2]


def complete(
    low: tuple[float, float],
    high: tuple[float, float],
    *,
    top_m: float = 1.5,
    gap_m: float = 0.0,
    angle: float = 0.0,
    lidars: tuple[tuple[float, float], ...] = ((0.0, 0.0),),
    kinds: Kinds = KINDS,
    given: I64 | None = None,
    directions: Directions | None = None,
) -> CompletedBoxes:
    """Clusters in one place (one for each class that is given), seen in equal parts by all lidars."""
    n = 1 if given is None else len(given)
    rectangles = Rectangles(np.full(n, angle), np.tile(low, (n, 1)), np.tile(high, (n, 1)), np.zeros(n))
    share = np.full((n, len(lidars)), 1 / len(lidars))
    heights = np.full(n, top_m), np.full(n, gap_m)
    return complete_boxes(rectangles, *heights, share, np.array(lidars), kinds, given, directions)


@pytest.mark.parametrize(
    ("low", "high", "lidar", "center", "size"),
    [
        pytest.param(
            (10.0, -0.85), (10.3, 0.85), (0.0, 0.0), (10 + LENGTH / 2, 0), (LENGTH, 1.7), id="rear grows forward"
        ),
        pytest.param(
            (10.0, -0.85), (10.3, 0.85), (30.0, 0.0), (10.3 - LENGTH / 2, 0), (LENGTH, 1.7), id="front, backward"
        ),
        pytest.param(
            (-2.0, 8.0), (2.1, 8.3), (0.0, 0.0), (0.05, 8 + WIDTH / 2), (4.1, WIDTH), id="side grows in width"
        ),
    ],
)
def test_a_car_grows_away_from_the_lidar(
    low: tuple[float, float],
    high: tuple[float, float],
    lidar: tuple[float, float],
    center: tuple[float, float],
    size: tuple[float, float],
) -> None:
    box = complete(low, high, lidars=(lidar,))
    assert box.class_ids.tolist() == [CAR]
    assert box.center_xy[0] == pytest.approx(center)
    assert box.sizes[0] == pytest.approx([*size, 1.5])
    assert box.yaw_rad[0] == 0.0
    grown = int(size[0] != LENGTH)
    assert box.center_std_m[0, grown] > box.center_std_m[0, 1 - grown]


def test_length_along_the_second_axis_turns_the_yaw() -> None:
    box = complete((8.0, -2.0), (8.3, 2.1))
    assert box.yaw_rad[0] == pytest.approx(np.pi / 2)
    assert box.sizes[0, :2] == pytest.approx([4.1, WIDTH])
    assert complete((8.0, -2.0), (8.3, 2.1), angle=0.4).yaw_rad[0] == pytest.approx(0.4 - np.pi / 2)


@pytest.mark.parametrize(
    ("size_m", "yaw", "sigma", "expected"),
    [
        pytest.param((2.0, 2.2), 0.3, 0.33, 0.0, id="a corner, along"),
        pytest.param((2.0, 2.2), 0.3 - np.pi, 0.33, 0.0, id="reversed"),
        pytest.param((2.0, 2.2), 1.3, 0.33, np.pi / 2, id="across"),
        pytest.param((4.1, 1.7), 1.3, 0.33, 0.0, id="the size contradicts"),
        pytest.param((1.7, 4.1), 0.3, 3.0, np.pi / 2, id="hardly known"),
    ],
)
def test_a_known_direction_and_the_size_tell_which_side_is_the_length(
    size_m: tuple[float, float], yaw: float, sigma: float, expected: float
) -> None:
    directions = Directions(np.array([yaw]), np.array([sigma**2]), Axes.unknown(1))
    box = complete((8.0, -1.0), (8.0 + size_m[0], size_m[1] - 1.0), given=np.array([CAR]), directions=directions)
    assert abs(box.yaw_rad[0]) == pytest.approx(expected)


def test_rider_is_in_the_middle_of_a_cyclist() -> None:
    box = complete((10.0, -0.25), (10.6, 0.25), top_m=1.7, given=np.array([BICYCLE]))
    assert box.center_xy[0] == pytest.approx([10.3, 0.0])
    assert box.sizes[0, :2] == pytest.approx(PRIORS[BICYCLE].size_m[:2])  # whatever was seen of it
    assert (box.class_ids.tolist(), box.rides.tolist()) == ([BICYCLE], [True])
    assert box.center_std_m[0] == pytest.approx([0.3, 0.025])


def test_people_are_not_smaller_than_their_class_however_much_of_a_side_is_seen() -> None:
    size = PRIORS[PEDESTRIAN].size_m[:2]
    assert 0.8 * size[1] < 0.6  # of a car, such a side would be complete
    assert complete((10.0, -0.3), (10.2, 0.3), top_m=1.75).sizes[0, :2] == pytest.approx(size)
    assert complete((10.0, -0.4), (10.2, 0.4), top_m=1.75).sizes[0, :2].max() == pytest.approx(0.8)


def test_a_pedestrian_grows_a_quarter_as_far_away_from_the_lidar_as_a_car() -> None:
    depth = PRIORS[PEDESTRIAN].size_m[0]
    box = complete((10.0, -0.25), (10.2, 0.25), top_m=1.75)
    assert box.class_ids.tolist() == [PEDESTRIAN]
    assert box.sizes[0, :2].max() == pytest.approx(depth)
    assert box.center_xy[0] == pytest.approx([10.1 + (depth - 0.2) / 8, 0.0])
    behind = complete((10.0, -0.25), (10.2, 0.25), top_m=1.75, lidars=((20.0, 0.0),))
    assert behind.center_xy[0] == pytest.approx([10.1 - (depth - 0.2) / 8, 0.0])


def test_a_given_class_is_kept_whatever_the_size_and_minus_one_is_chosen() -> None:
    boxes = complete((10.0, -0.85), (14.0, 0.85), given=np.array([PEDESTRIAN, -1, TRUCK]))
    assert boxes.class_ids.tolist() == [PEDESTRIAN, CAR, TRUCK]
    assert boxes.misfit[0] > boxes.misfit[2] > boxes.misfit[1]


def test_car_that_lidars_at_both_ends_saw_is_left_as_measured() -> None:
    box = complete((10.0, -0.75), (13.2, 0.75), lidars=((0.0, 0.0), (25.0, 0.0)))
    assert box.center_xy[0] == pytest.approx([11.6, 0.0])
    assert box.sizes[0, :2] == pytest.approx([3.2, 1.5])
    assert box.center_std_m[0] == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(
    ("high", "top_m", "name"),
    [
        ((10.4, 0.25), 1.75, "pedestrian"),
        ((11.8, 0.3), 1.7, "bicycle"),
        ((10.5, 1.3), 3.1, "truck"),
        ((14.2, 0.85), 1.5, "car"),
        ((22.0, 1.25), 3.2, "bus"),
        pytest.param((10.3, 15.0), 1.5, "", id="too long"),
        pytest.param((16.0, 2.0), 1.5, "", id="too wide"),
        pytest.param((14.0, 0.85), 4.5, "", id="too tall"),
    ],
)
def test_class_by_size(high: tuple[float, float], top_m: float, name: str) -> None:
    box = complete((10.0, -high[1]), high, top_m=top_m, lidars=((0.0, 4.0), (20.0, -4.0)))
    names = [*(prior.name for prior in PRIORS), ""]
    assert names[box.class_ids[0]] == name


@pytest.mark.parametrize(
    ("given", "top_m", "gap_m", "height_m"),
    [
        pytest.param(CAR, 0.9, 0.0, HEIGHT, id="low part"),
        pytest.param(CAR, 1.4, 0.3, 1.4, id="roof"),
        pytest.param(PEDESTRIAN, 1.45, 0.35, TALL, id="the top is between two beams"),
        pytest.param(PEDESTRIAN, 1.45, 0.1, 1.55, id="no higher than the next beam"),
        pytest.param(PEDESTRIAN, 1.9, 0.35, 1.9, id="taller than usual"),
        pytest.param(PEDESTRIAN, 1.3, 0.35, TALL, id="head hidden"),
    ],
)
def test_heights(given: int, top_m: float, gap_m: float, height_m: float) -> None:
    box = complete((10.0, -0.3), (10.3, 0.3), top_m=top_m, gap_m=gap_m, given=np.array([given]))
    assert box.sizes[0, 2] == pytest.approx(height_m)


@pytest.mark.parametrize("given", [None, np.array([TRUCK])])
def test_rear_of_a_van_grows_to_a_van_and_that_of_a_lorry_to_a_lorry(given: I64 | None) -> None:
    """Both are trucks."""
    for width, top_m, length in ((2.0, 2.4, PRIORS[TRUCK].kinds_m[0][0]), (2.5, 3.3, PRIORS[TRUCK].size_m[0])):
        box = complete((10.0, -width / 2), (10.3, width / 2), top_m=top_m, given=given)
        assert box.class_ids.tolist() == [TRUCK]
        assert box.sizes[0] == pytest.approx([length, width, top_m])
        assert box.center_xy[0, 0] == pytest.approx(10 + length / 2)


def test_rarer_class_loses_a_tie() -> None:
    twin = PRIORS[PEDESTRIAN].model_copy(update={"name": "twin", "frequency": 1.0})
    box = complete((10.0, -0.3), (10.6, 0.3), top_m=1.75, kinds=Kinds.of((PRIORS[PEDESTRIAN], twin)))
    assert box.class_ids.tolist() == [1]
