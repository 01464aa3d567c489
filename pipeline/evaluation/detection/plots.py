"""Data of the plots of a report: counts by score, for precision over recall, and errors by place."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.criteria import Criteria
from lidcam.pipeline.evaluation.detection.matching import match_frame
from lidcam.pipeline.evaluation.detection.tables import FALSE
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Figures
from lidcam.pipeline.evaluation.pieces import Pieces
from lidcam.pipeline.evaluation.vans import as_found

SCORES = 200
"""Steps of the score, and points of a curve of precision over recall."""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places and errors of true objects."""

    xy: F64  # (N, 2) float64, where they stand in the site frame, metres
    errors_m: F64  # (N,) float64, how far the centre of the detection is off, seen from above; NaN: it is missed


class DetectionPlots:
    """Gathers counts and errors over the frames of a result; keeps 24 bytes of each true object.

    A detection is right as for precision and recall: `Criteria.position`.

    Attributes:
        truth_counts: (C,) true objects that each source had to find, by class.
    """

    def __init__(self, config: Config) -> None:
        self._config, self._criteria = config, Criteria.of(config)
        self._counts: dict[str, I64] = {}
        self.truth_counts: dict[str, I64] = {}
        self._places = Pieces(Places, xy=(2,))

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame; those without truth are left out."""
        if frame.truth is None:
            return
        truth, classes = frame.truth, len(self._config.classes)
        for name, source in frame.sources.items():
            found = source.boxes
            _, matches, counted = match_frame(source, truth, self._criteria, self._config.evaluate)
            bins = np.clip(found.scores * SCORES, 0, SCORES - 1).astype(np.intp)
            shown = as_found(truth.class_ids, matches, found.class_ids)
            self.truth_counts[name] = self.truth_counts.get(name, 0) + np.bincount(shown[counted], minlength=classes)
            counts = self._counts.setdefault(name, np.zeros((classes, SCORES, 2), np.int64))
            for column, rows in enumerate((matches >= 0, matches == FALSE)):
                np.add.at(counts[:, :, column], (found.class_ids[rows], bins[rows]), 1)
            if name == "fused":
                right = np.flatnonzero(matches >= 0)
                errors = np.full(len(truth), np.nan)
                gaps = found.centers[right, :2] - truth.centers[matches[right], :2]
                errors[matches[right]] = np.hypot(gaps[:, 0], gaps[:, 1])
                self._places.append(Places(truth.centers[counted, :2], errors[counted]))

    @property
    def places(self) -> Places:
        """Places and errors of true objects."""
        return self._places.table()

    def curve(self, source: str, class_id: int) -> tuple[F64, F64, F64]:
        """Scores (P,), falling, and recall and precision of what has that score or more; empty without true objects."""
        counts, truth = self._counts[source][class_id, ::-1], int(self.truth_counts[source][class_id])
        right, false = counts.cumsum(0).T
        some = (counts.sum(1) > 0) & (truth > 0)
        scores = np.arange(SCORES - 1, -1, -1) / SCORES
        return scores[some], right[some] / max(truth, 1), right[some] / (right + false)[some]

    def figures(self) -> Figures:
        """None: the plots are read by themselves."""
        return {}
