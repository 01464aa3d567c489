"""Figures without truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, select_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, Figure, Figures, SourceBoxes, in_order
from lidcam.pipeline.evaluation.ignoring import is_within
from lidcam.pipeline.evaluation.pieces import Pieces
from lidcam.pipeline.evaluation.scales import is_flip
from lidcam.pipeline.evaluation.unlabelled.linking import MAX_GAP_FRAMES, Linker
from lidcam.pipeline.evaluation.unlabelled.residuals import Residuals

_FUSED = "fused"
"""The source whose boxes are compared with images."""


class UnlabelledEvaluation:
    """Figures of a result alone: of chains of boxes, of boxes in images, of the skew of stamps.

    Args:
        config: Classes; how boxes are matched (`associate`); region and range that are evaluated.
        cameras: Cameras with calibration.
    """

    def __init__(self, config: Config, cameras: Sequence[CameraSensor]) -> None:
        self._config = config
        self._sources: dict[str, _Source] = {}
        self._residuals = {camera.name: Residuals(camera, config) for camera in cameras}
        self._skews_ns: list[int] = []

    def add(self, frame: EvaluationFrame) -> None:
        """Take in one frame.

        Raises:
            FrameError: boxes are not in the site frame of the cameras.
        """
        if frame.skew_ns is not None:
            self._skews_ns.append(frame.skew_ns)
        for name, found in frame.sources.items():
            if name not in self._sources:
                self._sources[name] = _Source(self._config)
            self._sources[name].add(frame, found)
        if _FUSED in frame.sources:
            for camera in frame.images.keys() & self._residuals.keys():
                self._residuals[camera].add(frame.sources[_FUSED].boxes, frame.images[camera].found)

    def figures(self) -> Figures:
        """`unlabelled.SOURCE` and `sync`."""
        skews_ms = np.array(self._skews_ns, np.float64) / 1e6
        some = len(skews_ms) > 0
        return {
            "unlabelled": {
                name: {**self._sources[name].figures(), **self._images(name)} for name in in_order(self._sources)
            },
            "sync": {
                "skew_mean_ms": float(skews_ms.mean()) if some else None,
                "skew_max_ms": float(skews_ms.max()) if some else None,
            },
        }

    def _images(self, source: str) -> Figures:
        if source != _FUSED:
            return {}
        return {"images": {camera: residuals.figures() for camera, residuals in self._residuals.items()}}


@dataclass(frozen=True, slots=True, eq=False)
class _Boxes:
    """Boxes of all frames, in the order of time.

    Attributes:
        tracks: (N,) int64, or `UNKNOWN`.
        chains: (N,) int64, by place; of `_chained` boxes, numbers from 0 without gaps.
        frames: (N,) int64.
        stamps_ns: (N,) int64.
        yaws: (N,) float64.
        class_ids: (N,) int64.
    """

    tracks: I64
    chains: I64
    frames: I64
    stamps_ns: I64
    yaws: F64
    class_ids: I64


class _Source:
    """The objects of one 3D source."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._linker = Linker(np.array([prior.size_m[0] for prior in config.classes]))
        none = np.zeros(0, np.int64)
        self._boxes = Pieces(_Boxes(none, none, none, none, np.zeros(0), none))
        self._frames = 0

    def add(self, frame: EvaluationFrame, found: SourceBoxes) -> None:
        found = found.select(is_within(found.boxes.centers, self._config.evaluate))
        boxes = found.boxes
        self._frames += 1
        self._boxes.append(
            _Boxes(
                found.track_ids,
                self._linker.link(frame.index, boxes, frame.stamp_ns),
                np.full(len(boxes), frame.index, np.int64),
                np.full(len(boxes), frame.stamp_ns, np.int64),
                boxes.yaws,
                boxes.class_ids.astype(np.int64),
            )
        )

    def figures(self) -> Figures:
        boxes = self._boxes.table()
        per_frame = len(boxes.chains) / self._frames
        return {"objects": {"per_frame_mean": per_frame}, "chains": _chain_figures(_chained(boxes))}


def _chained(boxes: _Boxes) -> _Boxes:
    """The boxes by chain, then by time: those of a track where there are any; a chain ends where time does not rise."""
    names = boxes.tracks if (boxes.tracks != UNKNOWN).any() else boxes.chains
    rows = np.flatnonzero(names != UNKNOWN)
    rows = rows[np.lexsort((boxes.frames[rows], names[rows]))]
    starts = np.ones(len(rows), np.bool_)
    starts[1:] = (np.diff(names[rows]) != 0) | (np.diff(boxes.stamps_ns[rows]) <= 0)
    return replace(select_rows(boxes, rows), chains=(np.cumsum(starts) - 1).astype(np.int64))


def _chain_figures(boxes: _Boxes) -> dict[str, Figure]:
    """How long chains are, and what changes in them; None where there are none."""
    lengths = np.bincount(boxes.chains)
    first, last = np.cumsum(lengths) - lengths, np.cumsum(lengths) - 1
    seconds = (boxes.stamps_ns[last] - boxes.stamps_ns[first]) / 1e9
    spans = boxes.frames[last] - boxes.frames[first] + 1
    same = np.diff(boxes.chains) == 0
    missing = np.diff(boxes.frames)[same] - 1
    some = len(lengths) > 0
    return {
        "chains": len(lengths),
        "seconds_mean": float(seconds.mean()) if some else None,
        "flickers": int(((missing > 0) & (missing <= MAX_GAP_FRAMES)).sum()),
        "missing_share": float(1 - lengths.sum() / spans.sum()) if some else None,
        "class_changes": int((same & (np.diff(boxes.class_ids) != 0)).sum()),
        "heading_flips": int((same & is_flip(wrap_angle(np.diff(boxes.yaws)))).sum()),
    }
