"""Two results, object by object and frame by frame."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import Bools, Indices
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.evaluation.comparison.differences import Channel, Difference, Episodes, Listing
from lidcam.pipeline.evaluation.comparison.object_changes import (
    KINDS,
    PAIR_KINDS,
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
from lidcam.pipeline.evaluation.evaluation_frame import ResultFrame


class Tally:
    """Counts the objects of one channel; `units` has the kinds that are measured of objects that both results have."""

    def __init__(self, class_names: Sequence[str], allowed: Collection[Kind], units: dict[Kind, str]) -> None:
        self.class_names, self._units = tuple(class_names), units
        self._is_allowed = np.array([kind in allowed for kind in KINDS])
        counted = ("a", "b", "both", "equal", "different", "not_allowed", *KINDS)
        self._counts = {name: np.zeros(len(self.class_names), np.int64) for name in counted}
        self._largest = np.zeros((len(self.class_names), len(PAIR_KINDS)))

    def add_changes(self, changes: Changes, first_classes: Indices, second_classes: Indices) -> None:
        """Take in a frame, with the class of each object of A and B: a row of the names.

        An object that both have counts with its class in A.
        """
        paired, lost, new = first_classes[changes.first], first_classes[changes.lost], second_classes[changes.new]
        changed = changes.is_changed.any(1)
        forbidden = (changes.is_changed & ~self._is_allowed[2:]).any(1)
        alone = [rows for rows, is_allowed in zip((lost, new), self._is_allowed, strict=False) if not is_allowed]
        found = {
            "a": first_classes,
            "b": second_classes,
            "both": paired,
            "equal": paired[~changed],
            "different": np.concatenate([paired[changed], lost, new]),
            "not_allowed": np.concatenate([paired[forbidden], *alone]),
            "lost": lost,
            "new": new,
        } | {kind: paired[of_kind] for kind, of_kind in zip(PAIR_KINDS, changes.is_changed.T, strict=True)}
        for name, classes in found.items():
            self._counts[name] += np.bincount(classes, minlength=len(self.class_names))
        np.maximum.at(self._largest, paired, changes.amounts)

    @property
    def not_allowed_percent(self) -> float:
        """Share of the objects that differ in what is not allowed to; 0 without objects."""
        return self._of(np.ones(len(self.class_names), np.bool_))["not_allowed_percent"] or 0.0

    def figures(self) -> dict[str, dict[str, Any]]:
        """Figures by class, those that occur, and of `all`."""
        occurs = (self._counts["a"] + self._counts["b"]) > 0
        rows = {"all": np.ones(len(self.class_names), np.bool_)}
        rows |= {
            name: np.arange(len(self.class_names)) == row for row, name in enumerate(self.class_names) if occurs[row]
        }
        return {name: self._of(mask) for name, mask in rows.items()}

    def _of(self, mask: Bools) -> dict[str, Any]:
        counts = {name: int(count[mask].sum()) for name, count in self._counts.items()}
        objects = counts["equal"] + counts["different"]  # those of both counted once
        percent = {
            f"{name}_percent": 100 * counts[name] / objects if objects else None
            for name in ("different", "not_allowed")
        }
        largest = {
            "_".join(filter(None, ("largest", kind, unit))): (
                float(self._largest[mask, PAIR_KINDS.index(kind)].max(initial=0.0)) if counts["both"] else None
            )
            for kind, unit in self._units.items()
        }
        kinds = {str(kind): counts.pop(kind) for kind in KINDS}
        return {**counts, **percent, **kinds, **largest}


UNITS_3D: dict[Kind, str] = {"moved": "m", "turned": "deg", "resized": "m", "rescored": ""}
UNITS_2D: dict[Kind, str] = {"moved": "px", "rescored": ""}

MAX_APART_NS = 10_000_000
"""Maximum difference of the stamps of frames that show the same moment."""

FramePair = tuple[ResultFrame | None, ResultFrame | None]
"""The frames of A and B at one time; one of them is None where the other result alone has a frame."""


@dataclass(frozen=True, slots=True)
class _Channel:
    """One source or camera: its boxes in a frame, the objects of these, and how those of A and B differ."""

    name: str
    boxes: Callable[[ResultFrame], Mapping[str, Any]]
    objects: Callable[[Any, KnownClasses], Objects[Any]]
    changes: Callable[[Objects[Any], Objects[Any]], Changes]
    tally: Tally
    episodes: Episodes


class Comparison:
    """Compares frame after frame of results with the classes of A and B; memory does not grow with their number.

    Figures are in the order of the channels; the kinds of differences in `allowed` may be.
    """

    def __init__(
        self,
        first: Sequence[ClassPrior],
        second: Sequence[ClassPrior],
        channels: Sequence[Channel],
        allowed: Collection[Kind] = (),
    ) -> None:
        self.class_names = names = tuple(dict.fromkeys(prior.name for prior in (*first, *second)))
        self._known = KnownClasses.of(first, names), KnownClasses.of(second, names)
        self._channels: dict[str, list[_Channel]] = {"sources": [], "images": []}
        for row, (kind, name) in enumerate(channels):
            episodes = Episodes((kind, name), row)
            if kind == "sources":
                changes = partial(source_changes, tracks=Tracks())
                tally = Tally(names, allowed, UNITS_3D)
                one = _Channel(name, lambda frame: frame.sources, source_objects, changes, tally, episodes)
            else:
                tally = Tally(names, allowed, UNITS_2D)
                one = _Channel(name, lambda frame: frame.cameras, image_objects, image_changes, tally, episodes)
            self._channels[kind].append(one)
        self._listing = Listing()
        self._frames = {"frames": 0, "frames_different": 0, "frames_only_in_a": 0, "frames_only_in_b": 0}
        self._start_ns: int | None = None
        self._pairs = 0

    def add_pair(self, pair: FramePair) -> None:
        """Take in two frames; of a frame that one result alone has, the objects do not count."""
        first, second = pair
        if self._start_ns is None:
            self._start_ns = min(frame.stamp_ns for frame in pair if frame is not None)
        if first is None or second is None:
            self._frames["frames_only_in_a" if second is None else "frames_only_in_b"] += 1
            self.close()
        else:
            found = [self._compare(channel, first, second) for channel in self._all_channels]
            self._frames["frames"] += 1
            self._frames["frames_different"] += any(found)
        self._pairs += 1

    def close(self) -> None:
        """End all differences: no frame follows, or none that can be compared with those before."""
        for one in self._all_channels:
            self._listing.take(one.episodes.add_frame(()))

    def not_allowed_percent(self, *, frames_may_differ: bool) -> dict[str, float]:
        """Share of the objects that differ in what is not allowed to, by source or camera.

        `frames` has the share of the frames that one result alone has, unless they may differ.
        """
        found = {one.name: one.tally.not_allowed_percent for one in self._all_channels}
        alone = 0 if frames_may_differ else self._frames["frames_only_in_a"] + self._frames["frames_only_in_b"]
        return {"frames": 100 * alone / max(alone + self._frames["frames"], 1)} | found

    def figures(self) -> dict[str, Any]:
        """Figures by source and camera and class, with the largest amounts; and the differences."""
        tallies = {kind: {one.name: one.tally.figures() for one in some} for kind, some in self._channels.items()}
        return {**self._frames, **tallies, "differences": self._listing.figures(self._start_ns or 0)}

    @property
    def _all_channels(self) -> list[_Channel]:
        return [*self._channels["sources"], *self._channels["images"]]

    def _compare(self, channel: _Channel, first: ResultFrame, second: ResultFrame) -> bool:
        """Whether anything differs; a frame without the source or camera has no objects, unless both are."""
        found = [channel.boxes(frame).get(channel.name) for frame in (first, second)]
        known = next((one for one in found if one is not None), None)
        differences: list[Difference] = []
        if known is not None:
            nothing = known.select(np.zeros(0, np.intp))
            a, b = (
                channel.objects(nothing if one is None else one, classes)
                for one, classes in zip(found, self._known, strict=True)
            )
            changes = channel.changes(a, b)
            channel.tally.add_changes(changes, a.classes, b.classes)
            differences += self._differences(changes, (first, a), (second, b))
        self._listing.take(channel.episodes.add_frame(differences))
        return bool(differences)

    def _differences(
        self, changes: Changes, first: tuple[ResultFrame, Objects[Any]], second: tuple[ResultFrame, Objects[Any]]
    ) -> Iterator[Difference]:
        """The objects that differ: those that both have, those of A alone, those of B alone."""
        a, b = first[1], second[1]
        found: list[tuple[tuple[ResultFrame, Objects[Any]], int, int, dict[Kind, float]]] = []
        for row in np.flatnonzero(changes.is_changed.any(1)).tolist():
            measured = zip(PAIR_KINDS, changes.amounts[row].tolist(), changes.is_changed[row].tolist(), strict=True)
            amounts = {kind: amount for kind, amount, is_changed in measured if is_changed}
            found.append((second, int(changes.second[row]), a.classes[changes.first[row]], amounts))
        found += [(first, row, a.classes[row], {"lost": float(a.boxes.scores[row])}) for row in changes.lost.tolist()]
        found += [(second, row, b.classes[row], {"new": float(b.boxes.scores[row])}) for row in changes.new.tolist()]
        for number, ((frame, objects), row, class_row, amounts) in enumerate(found):
            yield Difference(
                pair=self._pairs,
                row=number,
                frame=frame.index,
                stamp_ns=frame.stamp_ns,
                place=tuple(objects.places[row].tolist()),
                reach=float(objects.reaches[row]),
                class_name=self.class_names[class_row],
                new_class_name=self.class_names[objects.classes[row]],
                amounts=amounts,
            )


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
