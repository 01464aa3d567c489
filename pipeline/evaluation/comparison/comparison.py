"""Two results, object by object and frame by frame."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from pipeline.core.settings.classes import ClassPrior
from pipeline.core.settings.compare import CompareConfig
from pipeline.evaluation.comparison.channel import ChannelComparison, Compared, is_of_source
from pipeline.evaluation.comparison.listing import Listing
from pipeline.evaluation.comparison.objects import KnownClasses, SourceObjects
from pipeline.evaluation.comparison.records import Channel, FramePair, Kind

__all__ = ["Comparison"]

MAX_LISTED = 1000
"""Differences that are kept, the earliest ones; all are counted."""


class Comparison:
    """Takes in frame after frame; its memory does not grow with their number.

    Args:
        first: Classes of A.
        second: Classes of B.
        config: What counts as equal.
        channels: Sources and cameras, in the order in which they are told.
        allowed: Kinds of differences that may be.
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
        self._channels = {one: ChannelComparison(one, known, names, config, allowed) for one in channels}
        self._listing = Listing(MAX_LISTED)
        self._frames = {"frames": 0, "frames_different": 0, "frames_only_in_a": 0, "frames_only_in_b": 0}
        self._start_ns: int | None = None
        self._pairs = 0

    def add(self, pair: FramePair) -> Mapping[str, Compared[SourceObjects]]:
        """Take in two frames.

        Returns:
            What differs, by source; nothing if one result alone has a frame.
        """
        if self._start_ns is None:
            self._start_ns = min(frame.stamp_ns for frame in (pair.first, pair.second) if frame is not None)
        found: dict[str, Compared[SourceObjects]] = {}
        is_any = False
        if pair.first is None or pair.second is None:
            self._frames["frames_only_in_a" if pair.second is None else "frames_only_in_b"] += 1
            self.close()
        else:
            self._frames["frames"] += 1
            for row, (channel, comparison) in enumerate(self._channels.items()):
                compared = comparison.add(pair.first, pair.second)
                if compared is not None:
                    is_any |= compared.changes.are_any
                    if is_of_source(compared):
                        found[channel[1]] = compared
                told = comparison.tell(compared, pair.first, pair.second, pair=self._pairs, is_next=pair.is_next)
                self._listing.take(told, row)
            self._frames["frames_different"] += is_any
        self._pairs += 1
        return found

    def close(self) -> None:
        """Take in that no frame follows, or none that can be compared with those before."""
        for row, comparison in enumerate(self._channels.values()):
            self._listing.take(comparison.interrupt(), row)

    def not_allowed_percent(self, *, frames_may_differ: bool) -> dict[str, float]:
        """Share of the objects that differ in what is not allowed to, by source or camera.

        Args:
            frames_may_differ: Otherwise `frames` has the share of the frames that one result alone has.
        """
        found = {name: comparison.tally.not_allowed_percent for (_, name), comparison in self._channels.items()}
        alone = 0 if frames_may_differ else self._frames["frames_only_in_a"] + self._frames["frames_only_in_b"]
        return {"frames": 100 * alone / max(alone + self._frames["frames"], 1)} | found

    def figures(self) -> dict[str, Any]:
        """Figures by source and camera and class; the differences, and the largest of each kind."""
        tree: dict[str, Any] = {**self._frames, "sources": {}, "images": {}}
        for (kind, name), comparison in self._channels.items():
            tree[kind][name] = comparison.tally.figures()
        return tree | {"differences": self._listing.figures(self._start_ns or 0)}
