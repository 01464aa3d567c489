"""Two results, object by object and frame by frame."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np

from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.evaluate import CompareConfig
from lidcam.pipeline.evaluation.comparison.differences import Channel, Difference, Episodes, Listing
from lidcam.pipeline.evaluation.comparison.frames import ComparedFrame, FramePair
from lidcam.pipeline.evaluation.comparison.object_changes import (
    PAIR_KINDS,
    Boxes,
    Changes,
    Kind,
    KnownClasses,
    Objects,
    Tracks,
    image_changes,
    image_objects,
    source_changes,
    source_objects,
)
from lidcam.pipeline.evaluation.comparison.tally import Tally
from lidcam.pipeline.evaluation.evaluation_frame import SourceBoxes

MAX_LISTED = 1000
"""Differences that are kept, the earliest ones; all are counted."""

UNITS_3D: dict[Kind, str] = {"moved": "m", "turned": "deg", "resized": "m", "rescored": ""}
UNITS_2D: dict[Kind, str] = {"moved": "px", "rescored": ""}

NO_ROWS = np.zeros(0, np.intp)
Known = tuple[KnownClasses, KnownClasses]

Found = TypeVar("Found", SourceBoxes, Boxes2D)


@dataclass(frozen=True, slots=True, eq=False)
class Compared(Generic[Boxes]):
    """A source or camera in one frame of both results.

    Attributes:
        first: Objects of A.
        second: Objects of B.
        changes: Their differences.
    """

    first: Objects[Boxes]
    second: Objects[Boxes]
    changes: Changes


class Comparison:
    """Takes in frame after frame of results with the classes of A and B; its memory does not grow with their number.

    The channels are in the order of the figures; the kinds of differences in `allowed` may be.
    """

    def __init__(
        self,
        first: Sequence[ClassPrior],
        second: Sequence[ClassPrior],
        config: CompareConfig,
        channels: Sequence[Channel],
        allowed: Collection[Kind] = (),
    ) -> None:
        names = tuple(dict.fromkeys(prior.name for prior in (*first, *second)))
        known = KnownClasses.of(first, names), KnownClasses.of(second, names)
        self.class_names = names
        self._channels: list[_Channel] = []
        for row, channel in enumerate(channels):
            kind, name = channel
            if kind == "sources":
                compare: Compare = partial(_compared_3d, name, known, config, Tracks())
                tally = Tally(names, allowed, UNITS_3D)
            else:
                compare, tally = partial(_compared_2d, name, known, config), Tally(names, allowed, UNITS_2D)
            self._channels.append(_Channel(channel, compare, tally, Episodes(channel, row)))
        self._listing = Listing(MAX_LISTED)
        self._frames = {"frames": 0, "frames_different": 0, "frames_only_in_a": 0, "frames_only_in_b": 0}
        self._start_ns: int | None = None
        self._pairs = 0

    def add(self, pair: FramePair) -> Mapping[str, Compared[Boxes3D]]:
        """Take in two frames.

        Returns:
            What differs, by source; nothing if one result alone has a frame.
        """
        if self._start_ns is None:
            self._start_ns = min(frame.stamp_ns for frame in (pair.first, pair.second) if frame is not None)
        number = self._pairs
        self._pairs += 1
        if pair.first is None or pair.second is None:
            self._frames["frames_only_in_a" if pair.second is None else "frames_only_in_b"] += 1
            self.close()
            return {}
        found: dict[Channel, Compared[Any]] = {}
        for one in self._channels:
            differences: list[Difference] = []
            if compared := one.compare(pair.first, pair.second):
                found[one.channel] = compared
                one.tally.add(compared.changes, compared.first.classes, compared.second.classes)
                differences += _differences(compared, pair.first, pair.second, self.class_names, number)
            self._listing.take(one.episodes.add(differences, is_next=pair.is_next))
        self._frames["frames"] += 1
        self._frames["frames_different"] += any(compared.changes.are_any for compared in found.values())
        return {name: compared for (kind, name), compared in found.items() if kind == "sources"}

    def close(self) -> None:
        """Take in that no frame follows, or none that can be compared with those before."""
        for one in self._channels:
            self._listing.take(one.episodes.add((), is_next=False))

    def not_allowed_percent(self, *, frames_may_differ: bool) -> dict[str, float]:
        """Share of the objects that differ in what is not allowed to, by source or camera.

        `frames` has the share of the frames that one result alone has, unless they may differ.
        """
        found = {one.channel[1]: one.tally.not_allowed_percent for one in self._channels}
        alone = 0 if frames_may_differ else self._frames["frames_only_in_a"] + self._frames["frames_only_in_b"]
        return {"frames": 100 * alone / max(alone + self._frames["frames"], 1)} | found

    def figures(self) -> dict[str, Any]:
        """Figures by source and camera and class; the differences, and the largest of each kind."""
        by_kind: dict[str, dict[str, Any]] = {"sources": {}, "images": {}}
        for one in self._channels:
            kind, name = one.channel
            by_kind[kind][name] = one.tally.figures()
        return {**self._frames, **by_kind, "differences": self._listing.figures(self._start_ns or 0)}


Compare = Callable[[ComparedFrame, ComparedFrame], Compared[Any] | None]
"""Compares one source or camera of two frames; None if neither frame has it."""


@dataclass(frozen=True, slots=True)
class _Channel:
    """One source or camera: how it is compared, and what was found so far."""

    channel: Channel
    compare: Compare
    tally: Tally
    episodes: Episodes


def _differences(
    compared: Compared[Any], first: ComparedFrame, second: ComparedFrame, class_names: Sequence[str], pair: int
) -> Iterator[Difference]:
    """The objects that differ: those that both have, those of A alone, those of B alone."""
    changes, a, b = compared.changes, compared.first, compared.second
    found: list[tuple[ComparedFrame, Objects[Any], int, int, int, dict[Kind, float]]] = []
    for row in np.flatnonzero(changes.is_changed.any(1)).tolist():
        i, j = int(changes.first[row]), int(changes.second[row])
        measured = zip(PAIR_KINDS, changes.amounts[row].tolist(), changes.is_changed[row].tolist(), strict=True)
        amounts = {kind: amount for kind, amount, is_changed in measured if is_changed}
        found.append((second, b, j, a.classes[i], b.classes[j], amounts))
    for row in changes.lost.tolist():
        found.append((first, a, row, a.classes[row], a.classes[row], {"lost": float(a.boxes.scores[row])}))
    for row in changes.new.tolist():
        found.append((second, b, row, b.classes[row], b.classes[row], {"new": float(b.boxes.scores[row])}))
    for number, (frame, objects, row, old, new, amounts) in enumerate(found):
        place, reach = tuple(objects.places[row].tolist()), float(objects.reaches[row])
        names = class_names[old], class_names[new]
        yield Difference(pair, number, frame.index, frame.stamp_ns, place, reach, *names, amounts)


def _compared_3d(
    name: str, known: Known, config: CompareConfig, tracks: Tracks, first: ComparedFrame, second: ComparedFrame
) -> Compared[Boxes3D] | None:
    both = _both(first.sources.get(name), second.sources.get(name))
    if both is None:
        return None
    a, b = source_objects(both[0], known[0]), source_objects(both[1], known[1])
    return Compared(a, b, source_changes(a, b, config, tracks))


def _compared_2d(
    name: str, known: Known, config: CompareConfig, first: ComparedFrame, second: ComparedFrame
) -> Compared[Boxes2D] | None:
    both = _both(first.cameras.get(name), second.cameras.get(name))
    if both is None:
        return None
    a, b = image_objects(both[0], known[0]), image_objects(both[1], known[1])
    return Compared(a, b, image_changes(a, b, config))


def _both(first: Found | None, second: Found | None) -> tuple[Found, Found] | None:
    """The boxes of both frames, empty for a frame that has none; None if neither frame has the source or camera."""
    if first is None:
        return None if second is None else (second.select(NO_ROWS), second)
    return first, first.select(NO_ROWS) if second is None else second
