import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from transforms import shift, transforms

from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree

SECOND = 10**9


def driving(*stamped: tuple[int, float], window_ns: int = 30 * SECOND) -> TransformTree:
    """A base that is so far along x of odom (metres) at times (seconds)."""
    tree = TransformTree(window_ns)
    for second, x_m in stamped:
        tree.add(second * SECOND, shift("odom", "base", x_m))
    return tree


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
    tree = driving((0, 0), (1, 1), (2, 4))
    assert tree.lookup("odom", "base", SECOND // 2).translation[0] == 0.5
    assert tree.lookup("odom", "base", 2 * SECOND).translation[0] == 4
    assert tree.lookup("odom", "base").translation[0] == 4
    for stamp in (-1, 2 * SECOND + 1):
        with pytest.raises(FrameError, match="known from 0 to 2000000000 ns"):
            tree.lookup("odom", "base", stamp)


@given(st.permutations(range(6)))
def test_the_order_of_arrival_does_not_matter(order: list[int]) -> None:
    tree = driving(*((second, second) for second in order))
    np.testing.assert_allclose(tree.lookup("odom", "base", round(2.5 * SECOND)).translation[0], 2.5)


def test_an_equal_stamp_replaces() -> None:
    tree = driving((0, 1), (0, 2))
    assert tree.lookup("odom", "base", 0).translation[0] == 2


def test_only_the_window_is_kept() -> None:
    tree = driving(*((second, second) for second in range(10)), window_ns=2 * SECOND)
    assert tree.lookup("odom", "base", 7 * SECOND).translation[0] == 7
    with pytest.raises(FrameError, match="known from 7000000000"):
        tree.lookup("odom", "base", 6 * SECOND)
    tree.add(0, shift("odom", "base", 99))  # too old to be kept
    with pytest.raises(FrameError, match="known from 7000000000"):
        tree.lookup("odom", "base", 6 * SECOND)


def test_a_new_parent_ends_the_old_motion_and_late_words_of_the_old_one_are_not_heard() -> None:
    tree = driving((0, 1))
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
    assert tree.frames == {"b", "x"}
    assert tree.is_static("x")
    assert not tree.is_static("b")


@pytest.mark.parametrize("edges", [[("a", "a")], [("a", "b"), ("b", "a")], [("a", "b"), ("b", "c"), ("c", "a")]])
def test_circles_are_told(edges: list[tuple[str, str]]) -> None:
    tree = TransformTree()
    for dst, src in edges:
        tree.add_static(shift(dst, src, 1))
    with pytest.raises(FrameError, match="run in a circle: "):
        tree.lookup("elsewhere", "a")
    with pytest.raises(FrameError, match="circle"):
        tree.root("a")
