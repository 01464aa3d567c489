"""What is compared, and what is found."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from pipeline.core.arrays import F64, Bools, Indices, check_array
from pipeline.core.detections import Boxes2D
from pipeline.evaluation.records import SourceBoxes

__all__ = ["KINDS", "PAIR_KINDS", "Changes", "Channel", "ComparedFrame", "FramePair", "Kind"]

Kind = Literal["lost", "new", "moved", "turned", "resized", "relabelled", "rescored", "reidentified"]
"""How an object of the second result B differs from that of the first one A.

`lost` is in A alone, `new` in B alone; `reidentified`: its track goes on under the id of another one.
"""

KINDS: tuple[Kind, ...] = ("lost", "new", "moved", "turned", "resized", "relabelled", "rescored", "reidentified")
PAIR_KINDS: tuple[Kind, ...] = KINDS[2:]
"""Those of an object that both results have."""

Channel = tuple[Literal["sources", "images"], str]
"""A source of 3D boxes, or a camera with its 2D boxes."""


class ComparedFrame(Protocol):
    """One frame of a result: `readers.results.result.ResultFrame`."""

    @property
    def index(self) -> int:
        """Its number, from 0."""
        ...

    @property
    def stamp_ns(self) -> int:
        """Its time."""
        ...

    @property
    def log_time_ns(self) -> int:
        """Log time of its messages."""
        ...

    @property
    def sources(self) -> Mapping[str, SourceBoxes]:
        """3D boxes by source."""
        ...

    @property
    def cameras(self) -> Mapping[str, Boxes2D]:
        """2D boxes by camera."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """The frames of two results at one time; one of them is None where the other result alone has a frame.

    Attributes:
        first: Of A.
        second: Of B.
        is_next: Whether it follows the pair before it in time; not after a jump back of the recording's time.
    """

    first: ComparedFrame | None
    second: ComparedFrame | None
    is_next: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """The objects of one channel in one frame of both results.

    Attributes:
        first: (M,) row in A of each object that both have.
        second: (M,) its row in B.
        lost: Rows in A of the objects that only A has.
        new: Rows in B of the objects that only B has.
        amounts: (M, 6) how far each object differs, by `PAIR_KINDS`: metres (pixels of a 2D box), degrees, metres, 1
            for another class, score, 1 for the id of another track.
        is_changed: (M, 6) whether that is more than what counts as equal.
    """

    first: Indices
    second: Indices
    lost: Indices
    new: Indices
    amounts: F64
    is_changed: Bools

    def __post_init__(self) -> None:
        shape = len(self.first), len(PAIR_KINDS)
        check_array("first", self.first, shape[:1], np.intp)
        check_array("second", self.second, shape[:1], np.intp)
        check_array("lost", self.lost, (len(self.lost),), np.intp)
        check_array("new", self.new, (len(self.new),), np.intp)
        check_array("amounts", self.amounts, shape, np.float64)
        check_array("is_changed", self.is_changed, shape, np.bool_)

    @property
    def are_any(self) -> bool:
        """Whether anything differs."""
        return bool(len(self.lost) or len(self.new) or self.is_changed.any())
