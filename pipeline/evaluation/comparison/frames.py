"""Frames of two results that show the same moment."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from lidcam.pipeline.evaluation.evaluation_frame import ResultFrame


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """The frames of two results at one time; one of them is None where the other result alone has a frame.

    Attributes:
        first: Of A.
        second: Of B.
        is_next: Whether it follows the pair before it in time; not after a jump back of the recording's time.
    """

    first: ResultFrame | None
    second: ResultFrame | None
    is_next: bool = True


def paired_frames(
    first: Iterable[ResultFrame], second: Iterable[ResultFrame], *, max_apart_ns: int
) -> Iterator[FramePair]:
    """The frames of two results side by side, in order of time; each frame once.

    A frame has as its partner the nearest one of the other result, if that is at most `max_apart_ns` away and has no
    nearer one itself; of two that are equally near, the earlier. Where a recording's time jumps back, both results
    begin a new part, and parts are compared with each other in their order. Frames are not held.
    """
    a, b = _Ahead(first), _Ahead(second)
    part = 0
    while a.here is not None or b.here is not None:
        here = min(one.key for one in (a, b) if one.here is not None)
        is_next, part = here[0] == part, here[0]
        apart_ns = _apart_ns(a.here, b.here) if a.part == b.part else None
        if apart_ns is not None and apart_ns <= max_apart_ns and not _is_nearer_later(a, b, apart_ns):
            yield FramePair(a.take(), b.take(), is_next)
        elif b.here is None or (a.here is not None and a.key <= b.key):
            yield FramePair(a.take(), None, is_next)
        else:
            yield FramePair(None, b.take(), is_next)


def _is_nearer_later(a: "_Ahead", b: "_Ahead", apart_ns: int) -> bool:
    """Whether the later one of two frames has a nearer partner, in the frame after the earlier one."""
    earlier, later = (a, b) if a.key <= b.key else (b, a)
    if earlier.after is None or later.here is None or earlier.part_after != later.part:
        return False
    return abs(earlier.after.stamp_ns - later.here.stamp_ns) < apart_ns


def _apart_ns(first: ResultFrame | None, second: ResultFrame | None) -> int | None:
    return None if first is None or second is None else abs(first.stamp_ns - second.stamp_ns)


class _Ahead:
    """Frames one by one, with a look at the next."""

    def __init__(self, frames: Iterable[ResultFrame]) -> None:
        self._frames = iter(frames)
        self.here = next(self._frames, None)
        self.after = next(self._frames, None)
        self.part = 0

    @property
    def part_after(self) -> int:
        """Part of the frame after this one."""
        is_back = self.here is not None and self.after is not None and self.after.stamp_ns < self.here.stamp_ns
        return self.part + is_back

    @property
    def key(self) -> tuple[int, int]:
        """Place of this frame in time."""
        return self.part, self.here.stamp_ns if self.here is not None else 0

    def take(self) -> ResultFrame | None:
        """This frame; the next one takes its place."""
        taken, self.part = self.here, self.part_after
        self.here, self.after = self.after, next(self._frames, None)
        return taken
