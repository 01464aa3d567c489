"""Differences of one object in frames that follow each other, told as one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.core.arrays import F64
from pipeline.evaluation.comparison.matching import match_places
from pipeline.evaluation.comparison.records import KINDS, Channel, Kind

__all__ = ["Difference", "Episode", "Episodes"]


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """One object that differs in one frame.

    Attributes:
        pair: Number of the pair of frames, from 0.
        row: Its place among the differences of the frame.
        frame: Number of the frame in B, in A of an object that only A has.
        stamp_ns: Time of that frame.
        place: Where the object is in that frame: x, y, z in metres, or the centre x, y in pixels.
        reach: How far it can be from its place in the frame before.
        class_name: Its class, in A unless only B has it.
        new_class_name: Its class in B.
        amounts: What differs, and by how much: see `Changes.amounts`; the score of an object that is lost or new.
    """

    pair: int
    row: int
    frame: int
    stamp_ns: int
    place: tuple[float, ...]
    reach: float
    class_name: str
    new_class_name: str
    amounts: Mapping[Kind, float]

    @property
    def presence(self) -> Kind:
        """`lost`, `new`, or `moved` for an object that both have, however it differs."""
        return next((kind for kind in KINDS[:2] if kind in self.amounts), "moved")


@dataclass(slots=True, eq=False)
class Episode:
    """One object that differs in frames one after the other.

    Attributes:
        channel: Where it was found.
        first: Its difference in the first frame.
        last: In the last.
        frames: Their number.
        counts: In how many of them it differs, by kind.
        worst: Largest amount, and where, by kind.
    """

    channel: Channel
    first: Difference
    last: Difference = field(init=False)
    frames: int = 0
    counts: dict[Kind, int] = field(default_factory=dict)
    worst: dict[Kind, tuple[float, Difference]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.add(self.first)

    def add(self, difference: Difference) -> None:
        """Take in the next frame."""
        self.last = difference
        self.frames += 1
        for kind, amount in difference.amounts.items():
            self.counts[kind] = self.counts.get(kind, 0) + 1
            if kind not in self.worst or amount > self.worst[kind][0]:
                self.worst[kind] = amount, difference


class Episodes:
    """Joins the differences of one channel; an episode ends with the first frame that has no part of it.

    Args:
        channel: The source or camera.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._open: list[Episode] = []

    def add(self, differences: Sequence[Difference], *, is_next: bool) -> list[Episode]:
        """Take in a frame.

        Args:
            differences: Of the frame.
            is_next: Whether it follows the frame before it.

        Returns:
            The episodes that are over.
        """
        going_on: list[Episode] = []
        known = self._open if is_next else []
        taken: set[int] = set()
        for presence in ("lost", "new", "moved"):
            mine = [one for one in differences if one.presence == presence]
            rows = [row for row, one in enumerate(known) if one.last.presence == presence]
            before = np.array([known[row].last.place for row in rows], np.float64)
            partner = _partners(before, mine)
            for one, row in zip(mine, partner, strict=True):
                if row is None:
                    going_on.append(Episode(self._channel, one))
                else:
                    episode = known[rows[row]]
                    taken.add(rows[row])
                    episode.add(one)
                    going_on.append(episode)
        over = [one for row, one in enumerate(self._open) if row not in taken]
        self._open = going_on
        return over


def _partners(before: F64, differences: Sequence[Difference]) -> list[int | None]:
    """Row in `before` of each difference, None for those that begin."""
    partners: list[int | None] = [None] * len(differences)
    if len(before) and differences:
        places = np.array([one.place for one in differences])
        gates = np.broadcast_to([max(one.reach, 1e-9) for one in differences], (len(before), len(differences)))
        for row, column in zip(*match_places(before, places, gates), strict=True):
            partners[int(column)] = int(row)
    return partners
