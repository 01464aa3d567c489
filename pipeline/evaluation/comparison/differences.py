"""Differences as they are listed: those of one object in frames that follow each other are one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.evaluation.comparison.object_changes import KINDS, Kind, pairs_of_least_cost

Channel = tuple[Literal["sources", "images"], str]
"""A source of 3D boxes, or a camera with its 2D boxes."""

MAX_LISTED = 1000
"""Largest number of differences that are kept, the earliest ones; all are counted."""

WITHOUT_AMOUNT = {"relabelled", "reidentified"}


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """One object that differs in one frame."""

    pair: int  # Number of the pair of frames, from 0
    row: int  # Its place among the differences of the frame
    frame: int  # Number of the frame in B, in A of an object that only A has
    stamp_ns: int  # Time of that frame
    place: tuple[float, ...]  # Where the object is in that frame: x, y, z in metres, or the centre x, y in pixels
    reach: float  # How far it can be from its place in the frame before
    class_name: str  # Its class, in A unless only B has it
    new_class_name: str  # Its class in B
    # Amount of each kind, as in `Changes.amounts`; the score of an object that is lost or new
    amounts: Mapping[Kind, float]

    @property
    def presence(self) -> Kind:
        """`lost`, `new`, or `moved` for an object that both have, however it differs."""
        return next((kind for kind in KINDS[:2] if kind in self.amounts), "moved")


class Episode:
    """One object that differs in one frame after the other.

    Attributes:
        key: Its place among all episodes: by first frame, then by channel, then by row.
        last: Its difference in the last frame.
    """

    def __init__(self, channel: Channel, channel_row: int, first: Difference) -> None:
        self.key = first.pair, channel_row, first.row
        self._largest: dict[Kind, float] = {}
        self._new_class: str | None = None
        self._named = {"source" if channel[0] == "sources" else "camera": channel[1]}
        self._first, self._frames = first, 0
        self._counts: dict[Kind, int] = {}
        self.extend(first)

    def extend(self, difference: Difference) -> None:
        """Take in the next frame."""
        self.last = difference
        self._frames += 1
        for kind, amount in difference.amounts.items():
            self._counts[kind] = self._counts.get(kind, 0) + 1
            self._largest[kind] = max(amount, self._largest.get(kind, amount))
        if "relabelled" in difference.amounts and self._new_class is None:
            self._new_class = difference.new_class_name

    def tree(self, start_ns: int) -> dict[str, Any]:
        """The episode as JSON has it, with seconds since `start_ns`."""
        first, last = self._first, self.last
        return {
            **self._named,
            "class": first.class_name,
            "new_class": self._new_class,
            "frames": self._frames,
            "first_frame": first.frame,
            "last_frame": last.frame,
            "first_s": _seconds(first, start_ns),
            "last_s": _seconds(last, start_ns),
            "first_stamp_ns": first.stamp_ns,
            "place": list(first.place),
            "kinds": {
                kind: {"frames": count, "largest": None if kind in WITHOUT_AMOUNT else self._largest[kind]}
                for kind in KINDS
                if (count := self._counts.get(kind))
            },
        }


def _seconds(difference: Difference, start_ns: int) -> float:
    return float(np.round((difference.stamp_ns - start_ns) / 1e9, 6))


class Episodes:
    """Joins the differences of one channel; an episode ends with the first frame that has no part of it."""

    def __init__(self, channel: Channel, row: int) -> None:
        self._channel, self._row = channel, row
        self._open: list[Episode] = []

    def add_frame(self, differences: Sequence[Difference]) -> list[Episode]:
        """Take in the differences of the next frame; returns the episodes that are over."""
        before = self._open
        going_on: list[Episode] = []
        for presence in ("lost", "new", "moved"):
            mine = [one for one in differences if one.presence == presence]
            known = [one for one in before if one.last.presence == presence]
            partners = _partners([one.last.place for one in known], mine)
            for number, one in enumerate(mine):
                if number in partners:
                    going_on.append(known[partners[number]])
                    going_on[-1].extend(one)
                else:
                    going_on.append(Episode(self._channel, self._row, one))
        self._open = going_on
        return [one for one in before if one not in going_on]


def _partners(before: Sequence[tuple[float, ...]], differences: Sequence[Difference]) -> dict[int, int]:
    """Row in `before` of each difference that goes on, by its number."""
    if not before or not differences:
        return {}
    reaches = np.maximum([one.reach for one in differences], 1e-9)
    places: F64 = np.array([one.place for one in differences], np.float64)
    distances = np.linalg.norm(np.array(before, np.float64)[:, None] - places, axis=-1)
    rows, columns = pairs_of_least_cost(distances / reaches)
    return dict(zip(columns.tolist(), rows.tolist(), strict=True))


class Listing:
    """Keeps the earliest episodes and counts all.

    Of those that begin in the same frame, sources come before cameras, and what comes first in the results.
    """

    def __init__(self) -> None:
        self._kept: list[Episode] = []
        self._count = 0

    def take(self, episodes: Sequence[Episode]) -> None:
        """Take in episodes that are over."""
        self._count += len(episodes)
        self._kept += episodes
        if len(self._kept) >= 2 * MAX_LISTED:
            self._shorten()

    def figures(self, start_ns: int) -> dict[str, Any]:
        """The number of episodes, and the earliest ones as JSON has them."""
        self._shorten()
        return {"count": self._count, "listed": [episode.tree(start_ns) for episode in self._kept]}

    def _shorten(self) -> None:
        self._kept.sort(key=lambda one: one.key)
        del self._kept[MAX_LISTED:]
