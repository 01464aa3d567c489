"""One source or camera of two results, frame by frame."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeGuard, TypeVar

import numpy as np

from pipeline.core.settings.compare import CompareConfig
from pipeline.evaluation.comparison.changes import Tracks, image_changes, source_changes
from pipeline.evaluation.comparison.episodes import Difference, Episode, Episodes
from pipeline.evaluation.comparison.objects import ImageObjects, KnownClasses, SourceObjects
from pipeline.evaluation.comparison.records import PAIR_KINDS, Changes, Channel, ComparedFrame, Kind
from pipeline.evaluation.comparison.tally import Tally

__all__ = ["ChannelComparison", "Compared", "is_of_source"]

_NO_ROWS = np.zeros(0, np.intp)


Objects = TypeVar("Objects", SourceObjects, ImageObjects)


@dataclass(frozen=True, slots=True, eq=False)
class Compared(Generic[Objects]):
    """A channel in one frame of both results.

    Attributes:
        first: Objects of A.
        second: Objects of B.
        changes: What differs.
    """

    first: Objects
    second: Objects
    changes: Changes


AnyCompared = Compared[SourceObjects] | Compared[ImageObjects]


def is_of_source(compared: AnyCompared) -> TypeGuard[Compared[SourceObjects]]:
    """Whether these are objects of a source, not boxes of a camera."""
    return isinstance(compared.first, SourceObjects)


class ChannelComparison:
    """Takes in frame after frame.

    Args:
        channel: The source or camera.
        known: Classes of A and of B.
        class_names: Of both.
        config: What counts as equal.
        allowed: Kinds of differences that may be.

    Attributes:
        tally: The counts.
    """

    def __init__(
        self,
        channel: Channel,
        known: tuple[KnownClasses, KnownClasses],
        class_names: Sequence[str],
        config: CompareConfig,
        allowed: Collection[Kind],
    ) -> None:
        self._channel, self._known, self._names, self._config = channel, known, class_names, config
        self.tally = Tally(class_names, allowed, "m" if channel[0] == "sources" else "px")
        self._episodes = Episodes(channel)
        self._tracks = Tracks()

    def add(self, first: ComparedFrame, second: ComparedFrame) -> AnyCompared | None:
        """Take in two frames; None if neither has a message of the channel. What only one has, is empty in the other.

        Returns:
            What differs; to be told to `tell`.
        """
        compared = self._sources(first, second) if self._channel[0] == "sources" else self._images(first, second)
        if compared is not None:
            self.tally.add(compared.changes, compared.first.classes, compared.second.classes)
        return compared

    def tell(
        self, compared: AnyCompared | None, first: ComparedFrame, second: ComparedFrame, *, pair: int, is_next: bool
    ) -> list[Episode]:
        """Join what differs with the frames before: the episodes that are over."""
        differences = [] if compared is None else [*self._differences(compared, first, second, pair)]
        return self._episodes.add(differences, is_next=is_next)

    def interrupt(self) -> list[Episode]:
        """Take in that the next frames do not follow, if there are any: the episodes that are over."""
        return self._episodes.add((), is_next=False)

    def _sources(self, first: ComparedFrame, second: ComparedFrame) -> Compared[SourceObjects] | None:
        a, b = first.sources.get(self._channel[1]), second.sources.get(self._channel[1])
        one = a or b
        if one is None:
            return None
        nothing = one.select(_NO_ROWS)
        objects = (
            SourceObjects(nothing if a is None else a, self._known[0]),
            SourceObjects(nothing if b is None else b, self._known[1]),
        )
        return Compared(*objects, source_changes(*objects, self._config, self._tracks))

    def _images(self, first: ComparedFrame, second: ComparedFrame) -> Compared[ImageObjects] | None:
        a, b = first.cameras.get(self._channel[1]), second.cameras.get(self._channel[1])
        one = a or b
        if one is None:
            return None
        nothing = one.select(_NO_ROWS)
        objects = (
            ImageObjects(nothing if a is None else a, self._known[0]),
            ImageObjects(nothing if b is None else b, self._known[1]),
        )
        return Compared(*objects, image_changes(*objects, self._config))

    def _differences(
        self, compared: AnyCompared, first: ComparedFrame, second: ComparedFrame, pair: int
    ) -> Iterator[Difference]:
        """The objects that differ: those that both have, those of A alone, those of B alone."""
        changes, a, b = compared.changes, compared.first, compared.second
        found: list[tuple[ComparedFrame, SourceObjects | ImageObjects, int, int, int, dict[Kind, float]]] = []
        for row in np.flatnonzero(changes.is_changed.any(1)).tolist():
            i, j = int(changes.first[row]), int(changes.second[row])
            amounts = {
                kind: float(changes.amounts[row, column])
                for column, kind in enumerate(PAIR_KINDS)
                if changes.is_changed[row, column]
            }
            found.append((second, b, j, int(a.classes[i]), int(b.classes[j]), amounts))
        for i in changes.lost.tolist():
            found.append((first, a, i, int(a.classes[i]), int(a.classes[i]), {"lost": float(a.scores[i])}))
        for j in changes.new.tolist():
            found.append((second, b, j, int(b.classes[j]), int(b.classes[j]), {"new": float(b.scores[j])}))
        for number, (frame, objects, row, old, new, amounts) in enumerate(found):
            place, reach = tuple(objects.places[row].tolist()), float(objects.reaches[row])
            names = self._names[old], self._names[new]
            yield Difference(pair, number, frame.index, frame.stamp_ns, place, reach, *names, amounts)
