"""Frames of two results that show the same moment."""

from collections.abc import Iterable, Iterator

from lidcam.pipeline.evaluation.evaluation_frame import ResultFrame

MAX_APART_NS = 10_000_000
"""Maximum difference of the stamps of frames that show the same moment."""


FramePair = tuple[ResultFrame | None, ResultFrame | None]
"""The frames of A and B at one time; one of them is None where the other result alone has a frame."""


def paired_frames(first: Iterable[ResultFrame], second: Iterable[ResultFrame]) -> Iterator[FramePair]:
    """The frames of two results side by side, in order of time; each frame once.

    A frame has as its partner the nearest one of the other result, if that is at most `MAX_APART_NS` away and has no
    nearer one itself; of two that are equally near, the earlier. Frames are not held.
    """
    a, b = _Ahead(first), _Ahead(second)
    while a.here is not None or b.here is not None:
        if a.here is None or b.here is None:
            yield a.take(), b.take()
            continue
        is_first_earlier = a.here.stamp_ns <= b.here.stamp_ns
        earlier, later = (a, b.here) if is_first_earlier else (b, a.here)
        apart_ns = abs(a.here.stamp_ns - b.here.stamp_ns)
        is_nearer_later = earlier.after is not None and abs(earlier.after.stamp_ns - later.stamp_ns) < apart_ns
        if apart_ns <= MAX_APART_NS and not is_nearer_later:
            yield a.take(), b.take()
        elif is_first_earlier:
            yield a.take(), None
        else:
            yield None, b.take()


class _Ahead:
    """Frames one by one, with a look at the next."""

    def __init__(self, frames: Iterable[ResultFrame]) -> None:
        self._frames = iter(frames)
        self.here = next(self._frames, None)
        self.after = next(self._frames, None)

    def take(self) -> ResultFrame | None:
        """This frame; the next one takes its place."""
        taken, self.here, self.after = self.here, self.after, next(self._frames, None)
        return taken
