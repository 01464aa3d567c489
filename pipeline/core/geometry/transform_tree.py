"""Fixed transforms between named frames."""

from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.transform import Transform

MAX_LINKS = 1000
"""Longest chain of transforms; a robot has a dozen."""


class TransformTree:
    """Static transforms as tf has them: each frame has one parent (REP 105)."""

    def __init__(self) -> None:
        self._edges: dict[str, Transform] = {}

    def add_static(self, transform: Transform) -> None:
        """Add a T_parent_child valid at all times; it replaces an earlier one of the same child."""
        self._edges[transform.src] = transform

    @property
    def frames(self) -> frozenset[str]:
        """All known frames."""
        return frozenset(name for edge in self._edges.values() for name in (edge.dst, edge.src))

    def edge(self, frame: str) -> Transform | None:
        """T_parent_frame; None for a root or an unknown frame."""
        return self._edges.get(frame)

    def parent(self, frame: str) -> str | None:
        """Parent of a frame; None for a root or an unknown frame."""
        return self._edges[frame].dst if frame in self._edges else None

    def root(self, frame: str) -> str:
        """The last ancestor of `frame`; the frame itself if it has no parent."""
        return self.chain(frame)[-1]

    def lookup(self, dst: str, src: str) -> Transform:
        """T_dst_src; raises FrameError if no path joins the frames."""
        up_src, up_dst = self.chain(src), self.chain(dst)
        common = next((frame for frame in up_src if frame in up_dst), None)
        if common is None:
            known = ", ".join(sorted(self.frames)) or "none at all"
            joined = f"frame {_with_root(up_src)} with {_with_root(up_dst)}"
            raise FrameError(f"no transform joins {joined}; frames with a fixed transform: {known}")
        return self._climb(dst, common).inverse() @ self._climb(src, common)

    def chain(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root; raises FrameError if these are a circle or too many."""
        chain: dict[str, None] = {frame: None}  # in order
        last = frame
        while (parent := self.parent(last)) is not None:
            if parent in chain:
                raise FrameError(f"the transforms run in a circle: {' -> '.join([*chain, parent])}")
            if len(chain) == MAX_LINKS:
                raise FrameError(f"more than {MAX_LINKS} transforms one after another lead from frame {frame!r}")
            chain[parent] = None
            last = parent
        return list(chain)

    def _climb(self, frame: str, ancestor: str) -> Transform:
        transform = Transform.identity(frame, frame)
        while transform.dst != ancestor:
            transform = self._edges[transform.dst] @ transform
        return transform


def _with_root(chain: list[str]) -> str:
    """A frame, with the tree that it is in."""
    return f"{chain[0]!r} (below {chain[-1]!r})" if len(chain) > 1 else repr(chain[0])
