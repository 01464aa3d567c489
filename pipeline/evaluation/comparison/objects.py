"""The objects of one channel in one frame, of a result that may know other classes than the one beside it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, Array, Indices
from pipeline.core.detections import Boxes2D
from pipeline.core.settings.classes import ClassPrior
from pipeline.evaluation.records import SourceBoxes

__all__ = ["ImageObjects", "KnownClasses", "SourceObjects"]


@dataclass(frozen=True, slots=True, eq=False)
class KnownClasses:
    """The classes of one result in terms of both.

    Attributes:
        rows: (C,) row in the names of both, by class id of the result.
        lengths_m: (C,) typical length, by class id.
    """

    rows: Indices
    lengths_m: F64

    @classmethod
    def of(cls, priors: Sequence[ClassPrior], names: Sequence[str]) -> "KnownClasses":
        """The classes of a result, among the names of both."""
        rows = [names.index(prior.name) for prior in priors]
        return cls(np.array(rows, np.intp), np.array([prior.size_m[0] for prior in priors], np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class SourceObjects:
    """Objects of one source.

    Attributes:
        found: The objects.
        known: The classes of their result.
    """

    found: SourceBoxes
    known: KnownClasses

    @property
    def classes(self) -> Indices:
        """(N,) rows of the names of both results."""
        return self.known.rows[self.found.boxes.class_ids]

    @property
    def lengths_m(self) -> F64:
        """(N,) typical lengths of their classes."""
        return self.known.lengths_m[self.found.boxes.class_ids]

    @property
    def places(self) -> F64:
        """(N, 3) centres, metres."""
        return self.found.boxes.centers

    @property
    def reaches(self) -> F64:
        """(N,) how far each can come from one frame to the next, metres."""
        return self.lengths_m

    @property
    def scores(self) -> Array:
        """(N,) in [0, 1]."""
        return self.found.boxes.scores


@dataclass(frozen=True, slots=True, eq=False)
class ImageObjects:
    """2D boxes of one camera.

    Attributes:
        found: The boxes.
        known: The classes of their result.
    """

    found: Boxes2D
    known: KnownClasses

    @property
    def classes(self) -> Indices:
        """(N,) rows of the names of both results."""
        return self.known.rows[self.found.class_ids]

    @property
    def places(self) -> F64:
        """(N, 2) centres, pixels."""
        xyxy = self.found.xyxy.astype(np.float64)
        return (xyxy[:, :2] + xyxy[:, 2:]) / 2

    @property
    def reaches(self) -> F64:
        """(N,) how far each can come from one frame to the next: as far as it is large, pixels."""
        xyxy = self.found.xyxy.astype(np.float64)
        return np.asarray((xyxy[:, 2:] - xyxy[:, :2]).max(1, initial=0.0))

    @property
    def scores(self) -> Array:
        """(N,) in [0, 1]."""
        return self.found.scores
