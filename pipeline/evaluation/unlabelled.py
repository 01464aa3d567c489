"""Figures without truth: how steady tracks are, and the skew of stamps."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, select_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, Figure, Figures, in_order
from lidcam.pipeline.evaluation.ignoring import is_within
from lidcam.pipeline.evaluation.pieces import Pieces
from lidcam.pipeline.evaluation.scales import is_flip

MAX_GAP_FRAMES = 5
"""Longest absence, in frames, that counts as a flicker."""


@dataclass(frozen=True, slots=True, eq=False)
class _Boxes:
    """Boxes of one source in the order of time."""

    tracks: I64  # (N,) int64, or `UNKNOWN`
    frames: I64  # (N,) int64
    stamps_ns: I64  # (N,) int64
    yaws: F64  # (N,) float64
    class_ids: I32  # (N,) int32


class UnlabelledEvaluation:
    """Figures of a result alone; `config` has the region and the range that are evaluated."""

    def __init__(self, config: Config) -> None:
        self._config = config.evaluate
        self._boxes: dict[str, Pieces[_Boxes]] = {}
        self._frames = Counter[str]()
        self._skews_ns: list[int] = []

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame."""
        if frame.skew_ns is not None:
            self._skews_ns.append(frame.skew_ns)
        for name, source in frame.sources.items():
            found = source.select(is_within(source.boxes.centers, self._config))
            frames, stamps_ns = np.full((2, len(found)), [[frame.index], [frame.stamp_ns]])
            boxes = _Boxes(found.track_ids, frames, stamps_ns, found.boxes.yaws, found.boxes.class_ids)
            self._boxes.setdefault(name, Pieces(_Boxes)).append(boxes)
            self._frames[name] += 1

    def figures(self) -> Figures:
        """`unlabelled.SOURCE` and `sync`."""
        skews_ms = np.array(self._skews_ns, np.float64) / 1e6
        some = len(skews_ms) > 0
        tables = {name: self._boxes[name].table() for name in in_order(self._boxes)}
        return {
            "unlabelled": {
                name: {
                    "objects": {"per_frame_mean": len(boxes.tracks) / self._frames[name]},
                    "chains": _chain_figures(select_rows(boxes, boxes.tracks != UNKNOWN)),
                }
                for name, boxes in tables.items()
            },
            "sync": {
                "skew_mean_ms": float(skews_ms.mean()) if some else None,
                "skew_max_ms": float(skews_ms.max()) if some else None,
            },
        }


def _chain_figures(boxes: _Boxes) -> dict[str, Figure]:
    """Lengths of tracks and changes within them; a chain of boxes also ends where time does not rise."""
    boxes = select_rows(boxes, np.lexsort((boxes.frames, boxes.tracks)))
    same = (np.diff(boxes.tracks) == 0) & (np.diff(boxes.stamps_ns) > 0)
    first = np.flatnonzero(np.append(np.ones(min(len(boxes.tracks), 1), np.bool_), ~same))
    last = np.append(first[1:], len(boxes.tracks))[: len(first)] - 1
    seconds = (boxes.stamps_ns[last] - boxes.stamps_ns[first]) / 1e9
    spans = boxes.frames[last] - boxes.frames[first] + 1
    missing = np.diff(boxes.frames)[same] - 1
    some = len(first) > 0
    return {
        "chains": len(first),
        "seconds_mean": float(seconds.mean()) if some else None,
        "flickers": int(((missing > 0) & (missing <= MAX_GAP_FRAMES)).sum()),
        "missing_share": float(1 - len(boxes.tracks) / spans.sum()) if some else None,
        "class_changes": int((same & (np.diff(boxes.class_ids) != 0)).sum()),
        "heading_flips": int((same & is_flip(wrap_angle(np.diff(boxes.yaws)))).sum()),
    }
