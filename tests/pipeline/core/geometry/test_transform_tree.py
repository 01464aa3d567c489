import numpy as np
import pytest
from hypothesis import given
from transforms import shift, transforms

from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree


def test_an_empty_tree_joins_a_frame_only_with_itself() -> None:
    tree = TransformTree()
    np.testing.assert_array_equal(tree.lookup("a", "a").matrix, np.eye(4))
    with pytest.raises(FrameError, match="joins frame 'b' with 'a'; frames with a fixed transform: none at all"):
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


def test_frames_of_two_trees_are_named_with_their_roots() -> None:
    tree = TransformTree()
    for transform in (shift("a", "x", 1), shift("b", "y", 1), shift("y", "z", 1)):
        tree.add_static(transform)
    with pytest.raises(FrameError, match=r"joins frame 'z' \(below 'b'\) with 'a'; .*: a, b, x, y, z$"):
        tree.lookup("a", "z")


def test_a_static_edge_can_be_hung_elsewhere() -> None:
    tree = TransformTree()
    tree.add_static(shift("a", "x", 1))
    tree.add_static(shift("b", "x", 2))
    assert tree.lookup("b", "x").translation[0] == 2
    assert tree.frames == {"b", "x"}
    assert tree.edge("x") is not None
    assert tree.edge("b") is None


@pytest.mark.parametrize("edges", [[("a", "a")], [("a", "b"), ("b", "a")], [("a", "b"), ("b", "c"), ("c", "a")]])
def test_circles_are_told(edges: list[tuple[str, str]]) -> None:
    tree = TransformTree()
    for dst, src in edges:
        tree.add_static(shift(dst, src, 1))
    with pytest.raises(FrameError, match="run in a circle: "):
        tree.lookup("elsewhere", "a")
    with pytest.raises(FrameError, match="circle"):
        tree.root("a")
