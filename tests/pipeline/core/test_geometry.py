from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from pipeline.core.errors import FrameError
from pipeline.core.geometry import (
    Transform,
    TransformTree,
    box_corners,
    interpolate_poses,
    rotation_fault,
    wrap_angle,
)

SECOND = 10**9
metres = st.floats(-1e3, 1e3)
vectors = st.tuples(metres, metres, metres)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-2)


@st.composite
def transforms(draw: st.DrawFn, dst: str = "b", src: str = "a") -> Transform:
    return Transform.from_quaternion(dst, src, draw(vectors), draw(quaternions))


def shift(dst: str, src: str, x: float) -> Transform:
    return Transform.from_quaternion(dst, src, [x, 0, 0], [0, 0, 0, 1])


# --- transforms


@given(transforms())
def test_a_transform_and_its_inverse_cancel(T_b_a: Transform) -> None:
    both = T_b_a.inverse() @ T_b_a
    assert (both.dst, both.src) == ("a", "a")
    np.testing.assert_allclose(both.matrix, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(T_b_a.inverse().matrix, np.linalg.inv(T_b_a.matrix), atol=1e-9)


@given(transforms("c", "b"), transforms("b", "a"), st.lists(vectors, min_size=1, max_size=5))
def test_chaining_is_applying_one_after_the_other(
    T_c_b: Transform, T_b_a: Transform, points: list[tuple[float, ...]]
) -> None:
    xyz = np.array(points)
    chained = T_c_b @ T_b_a
    assert (chained.dst, chained.src) == ("c", "a")
    np.testing.assert_allclose(chained.apply(xyz), T_c_b.apply(T_b_a.apply(xyz)), atol=1e-8)


@given(transforms(), vectors)
def test_rotations_are_rotations_and_keep_distances(T_b_a: Transform, point: tuple[float, ...]) -> None:
    assert rotation_fault(T_b_a.matrix[:3, :3]) is None
    moved = T_b_a.apply(np.array(point)) - T_b_a.translation
    np.testing.assert_allclose(np.linalg.norm(moved), np.linalg.norm(point), atol=1e-9)


@given(transforms())
def test_quaternions_round_trip(T_b_a: Transform) -> None:
    again = Transform.from_quaternion("b", "a", T_b_a.translation, T_b_a.quaternion_xyzw)
    np.testing.assert_allclose(again.matrix, T_b_a.matrix, atol=1e-12)
    assert T_b_a.quaternion_xyzw[3] >= 0


def test_chaining_unlike_frames_is_refused() -> None:
    with pytest.raises(FrameError, match="cannot chain b<-a with c<-b"):
        shift("b", "a", 1) @ shift("c", "b", 1)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(3,), (0, 3), (4, 3), (2, 5, 3)])
def test_apply_keeps_shape_and_dtype(dtype: type, shape: tuple[int, ...]) -> None:
    moved = shift("b", "a", 1).apply(np.zeros(shape, dtype))
    assert (moved.shape, moved.dtype) == (shape, np.dtype(dtype))


@pytest.mark.parametrize("matrix", [np.eye(3), np.eye(4, dtype=np.float32), np.zeros((4, 4), int)])
def test_a_transform_is_four_by_four_float64(matrix: npt.NDArray[Any]) -> None:
    with pytest.raises(ValueError, match=r"expected float64\[4, 4\]"):
        Transform("b", "a", matrix)


def test_a_transform_is_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        shift("b", "a", 1).matrix[0, 0] = 2


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, np.nan), (0, 0, 0, np.inf)])
def test_a_quaternion_without_length_is_refused(quaternion: tuple[float, ...]) -> None:
    with pytest.raises(FrameError, match="unit quaternion"):
        Transform.from_quaternion("b", "a", [0, 0, 0], quaternion)


@pytest.mark.parametrize(
    ("matrix", "fault"),
    [
        (np.eye(3), None),
        (np.eye(3) + 4e-4, None),  # three digits
        (np.diag([1.0, 1.0, 0.0]), "singular"),
        (np.zeros((3, 3)), "singular"),
        (np.diag([1.0, 1.0, -1.0]), "reflection"),
        (np.diag([2.0, 0.5, 1.0]), "orthonormal"),
        (np.full((3, 3), np.nan), "finite"),
    ],
)
def test_rotation_fault(matrix: npt.NDArray[np.float64], fault: str | None) -> None:
    found = rotation_fault(matrix)
    assert found is None if fault is None else fault in (found or "")


# --- angles and boxes


@given(st.floats(-1e6, 1e6))
def test_wrapped_angles_lie_in_the_half_open_turn_and_point_the_same_way(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)


@given(st.integers(-1000, 1000), st.integers(-3, 3))
def test_odd_multiples_of_pi_never_leave_the_range(turns: int, ulps: int) -> None:
    angle = (2 * turns + 1) * np.pi
    angle += ulps * np.spacing(angle)
    assert -np.pi < wrap_angle(angle) <= np.pi


def test_wrap_angle_keeps_what_is_in_range() -> None:
    angles = np.array([np.pi, 0.0, -3.0, 1e-300])
    np.testing.assert_array_equal(wrap_angle(angles), angles)
    assert wrap_angle(-np.pi) == np.pi


def test_box_corners_of_a_turned_box() -> None:
    # length 4, width 2, height 1 at (10, 0, 0), turned left by 90 degrees: its front looks to +y
    corners = box_corners(np.array([[10.0, 0, 0]]), np.array([[4.0, 2, 1]]), np.array([np.pi / 2]))[0]
    expected = [[9, 2, -0.5], [9, -2, -0.5], [11, -2, -0.5], [11, 2, -0.5]]
    np.testing.assert_allclose(corners[:4], expected, atol=1e-12)
    np.testing.assert_allclose(corners[4:], np.add(expected, [0, 0, 1]), atol=1e-12)


def test_no_boxes_have_no_corners() -> None:
    assert box_corners(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)).shape == (0, 8, 3)


# --- interpolation


@given(st.integers(0, 4 * SECOND), st.integers(-(10**18), 10**18))
def test_interpolation_is_slerp_and_linear_at_any_epoch(wanted_ns: int, epoch_ns: int) -> None:
    stamps = np.array([0, SECOND, 4 * SECOND], np.int64)
    turns = Rotation.from_rotvec([[0, 0, 0], [0.3, 0.1, 2.0], [1, -1, 0.5]])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = turns.as_matrix()
    poses[:, 0, 3] = [0, 10, -5]
    found = interpolate_poses(stamps + epoch_ns, poses, np.array([wanted_ns + epoch_ns], np.int64))[0]
    judge = Slerp(stamps.astype(float), turns)(float(wanted_ns))
    np.testing.assert_allclose(found[:3, :3], judge.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(found[0, 3], np.interp(wanted_ns, stamps, [0, 10, -5]), atol=1e-9)


def test_beyond_the_ends_the_motion_goes_on() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 1.0
    poses[1, :3, :3] = Rotation.from_euler("z", 0.1).as_matrix()
    wanted = np.array([-SECOND, 2 * SECOND, 3 * SECOND], np.int64)
    found = interpolate_poses(np.array([0, SECOND], np.int64), poses, wanted)
    np.testing.assert_allclose(found[:, 0, 3], [-1, 2, 3])
    np.testing.assert_allclose(Rotation.from_matrix(found[:, :3, :3]).as_euler("zyx")[:, 0], [-0.1, 0.2, 0.3])


def test_interpolating_at_no_time_gives_nothing() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    assert interpolate_poses(np.array([0, 1], np.int64), poses, np.zeros(0, np.int64)).shape == (0, 4, 4)


# --- the tree


def test_an_empty_tree_joins_a_frame_only_with_itself() -> None:
    tree = TransformTree()
    np.testing.assert_array_equal(tree.lookup("a", "a").matrix, np.eye(4))
    with pytest.raises(FrameError, match="no transform joins frame 'b' with 'a'; frames with a transform: none at all"):
        tree.lookup("a", "b")


@given(transforms("root", "left"), transforms("root", "right"), transforms("right", "tip"))
def test_frames_are_joined_over_their_common_ancestor(left: Transform, right: Transform, tip: Transform) -> None:
    tree = TransformTree()
    for transform in (left, right, tip):
        tree.add_static(transform)
    expected = left.inverse() @ right @ tip
    np.testing.assert_allclose(tree.lookup("left", "tip").matrix, expected.matrix, atol=1e-8)
    np.testing.assert_allclose(tree.lookup("tip", "left").matrix, expected.inverse().matrix, atol=1e-8)
    assert tree.root("tip") == "root"
    assert tree.chain("tip") == ["tip", "right", "root"]


def test_stamped_edges_are_interpolated_and_not_carried_beyond_their_ends() -> None:
    tree = TransformTree()
    for second in (0, 1, 2):
        tree.add(second * SECOND, shift("odom", "base", float(second) ** 2))
    assert tree.lookup("odom", "base", SECOND // 2).translation[0] == 0.5
    assert tree.lookup("odom", "base", 2 * SECOND).translation[0] == 4
    assert tree.lookup("odom", "base").translation[0] == 4
    for stamp in (-1, 2 * SECOND + 1):
        with pytest.raises(FrameError, match="known from 0 to 2000000000 ns"):
            tree.lookup("odom", "base", stamp)


@given(st.permutations(range(6)))
def test_the_order_of_arrival_does_not_matter(order: list[int]) -> None:
    tree = TransformTree()
    for second in order:
        tree.add(second * SECOND, shift("odom", "base", float(second)))
    np.testing.assert_allclose(tree.lookup("odom", "base", round(2.5 * SECOND)).translation[0], 2.5)


def test_an_equal_stamp_replaces() -> None:
    tree = TransformTree()
    tree.add(0, shift("odom", "base", 1))
    tree.add(0, shift("odom", "base", 2))
    assert tree.lookup("odom", "base", 0).translation[0] == 2


def test_only_the_window_is_kept() -> None:
    tree = TransformTree(window_ns=2 * SECOND)
    for second in range(10):
        tree.add(second * SECOND, shift("odom", "base", second))
    assert tree.lookup("odom", "base", 7 * SECOND).translation[0] == 7
    with pytest.raises(FrameError, match="known from 7000000000"):
        tree.lookup("odom", "base", 6 * SECOND)
    tree.add(0, shift("odom", "base", 99))  # too old to be kept
    with pytest.raises(FrameError, match="known from 7000000000"):
        tree.lookup("odom", "base", 6 * SECOND)


def test_a_new_parent_ends_the_old_motion_and_late_words_of_the_old_one_are_not_heard() -> None:
    tree = TransformTree()
    tree.add(0, shift("odom", "base", 1))
    tree.add(2 * SECOND, shift("map", "base", 2))
    assert tree.parent("base") == "map"
    tree.add(SECOND, shift("odom", "base", 3))
    assert tree.parent("base") == "map"
    assert tree.lookup("map", "base", 2 * SECOND).translation[0] == 2
    with pytest.raises(FrameError, match="no transform joins"):
        tree.lookup("odom", "base")


def test_a_static_edge_can_be_hung_elsewhere() -> None:
    tree = TransformTree()
    tree.add_static(shift("a", "x", 1))
    tree.add_static(shift("b", "x", 2))
    assert tree.lookup("b", "x").translation[0] == 2
    assert [(edge.dst, edge.src) for edge in tree.static_edges] == [("b", "x")]


@pytest.mark.parametrize("edges", [[("a", "a")], [("a", "b"), ("b", "a")], [("a", "b"), ("b", "c"), ("c", "a")]])
def test_circles_are_told(edges: list[tuple[str, str]]) -> None:
    tree = TransformTree()
    for dst, src in edges:
        tree.add_static(shift(dst, src, 1))
    with pytest.raises(FrameError, match="run in a circle: "):
        tree.lookup("elsewhere", "a")
    with pytest.raises(FrameError, match="circle"):
        tree.root("a")


def test_what_a_tree_knows_of_frames() -> None:
    tree = TransformTree()
    tree.add_static(shift("base", "lidar", 1))
    tree.add(0, shift("odom", "base", 1))
    assert tree.frames == {"odom", "base", "lidar"}
    assert (tree.parent("lidar"), tree.parent("base"), tree.parent("odom"), tree.parent("?")) == (
        "base",
        "odom",
        None,
        None,
    )
    assert tree.is_static("lidar")
    assert not tree.is_static("base")
