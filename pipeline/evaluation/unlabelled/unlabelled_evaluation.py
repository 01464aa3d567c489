"""Figures without truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, select_rows
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.rig import CameraSensor
from pipeline.core.settings.config import Config
from pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, Figure, Figures, SourceBoxes, in_order
from pipeline.evaluation.ignoring import is_within
from pipeline.evaluation.pieces import Pieces
from pipeline.evaluation.scales import is_flip
from pipeline.evaluation.unlabelled.linking import MAX_GAP_FRAMES, Linker
from pipeline.evaluation.unlabelled.residuals import Residuals

__all__ = ["UnlabelledEvaluation"]


class UnlabelledEvaluation:
    """What results say about themselves: nobody needs to know what was there.

    Args:
        config: Classes; how boxes are matched (`associate`); region and range of what is looked at.
        cameras: Cameras with calibration.
    """

    def __init__(self, config: Config, cameras: Sequence[CameraSensor]) -> None:
        self._config, self._cameras = config, tuple(cameras)
        self._sources: dict[str, _Source] = {}
        self._residuals: dict[tuple[str, str], Residuals] = {}
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
                for camera in self._cameras:
                    self._residuals[name, camera.name] = Residuals(camera, self._config)
            self._sources[name].add(frame, found)
            for camera in self._cameras:
                if camera.name in frame.images:
                    image = frame.images[camera.name]
                    self._residuals[name, camera.name].add(found.boxes, image.found)

    def figures(self) -> Figures:
        """`unlabelled.SOURCE` and `sync`."""
        skews_ms = np.array(self._skews_ns, np.float64) / 1e6
        some = len(skews_ms) > 0
        return {
            "unlabelled": {
                name: {
                    **self._sources[name].figures(),
                    "images": {camera.name: self._residuals[name, camera.name].figures() for camera in self._cameras},
                }
                for name in in_order(self._sources)
            },
            "sync": {
                "skew_mean_ms": float(skews_ms.mean()) if some else None,
                "skew_max_ms": float(skews_ms.max()) if some else None,
            },
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Boxes:
    """Boxes of all frames, in the order of time.

    Attributes:
        tracks: (N,) int64, or `UNKNOWN`.
        chains: (N,) int64, by place; once they are told, numbers from 0 without gaps.
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
        chained, names = _chained(boxes), self._config.class_names
        main = _main_classes(chained, len(names))
        by_class = {name: _chain_figures(chained, main == class_id) for class_id, name in enumerate(names)}
        return {
            "objects": {"per_frame_mean": len(boxes.chains) / self._frames},
            "chains": {**by_class, "all": _chain_figures(chained, np.ones(len(main), np.bool_))},
        }


def _chained(boxes: _Boxes) -> _Boxes:
    """The boxes by chain, then by time: those of a track where there are any; a chain ends where time does not rise."""
    names = boxes.tracks if (boxes.tracks != UNKNOWN).any() else boxes.chains
    rows = np.flatnonzero(names != UNKNOWN)
    rows = rows[np.lexsort((boxes.frames[rows], names[rows]))]
    starts = np.ones(len(rows), np.bool_)
    starts[1:] = (np.diff(names[rows]) != 0) | (np.diff(boxes.stamps_ns[rows]) <= 0)
    return replace(select_rows(boxes, rows), chains=(np.cumsum(starts) - 1).astype(np.int64))


def _main_classes(boxes: _Boxes, classes: int) -> I64:
    """(K,) the class that most boxes of each chain have; of equally many the first of the settings."""
    counts = np.zeros((int(boxes.chains.max(initial=-1)) + 1, classes), np.int64)
    np.add.at(counts, (boxes.chains, boxes.class_ids), 1)
    return np.asarray(counts.argmax(1), np.int64)


def _chain_figures(boxes: _Boxes, wanted: Bools) -> dict[str, Figure]:
    """How long those of the chains (K,) are that are wanted, and what changes in them; None where there are none."""
    part = select_rows(boxes, wanted[boxes.chains])
    lengths = np.bincount(part.chains, minlength=len(wanted))[wanted]
    first, last = np.cumsum(lengths) - lengths, np.cumsum(lengths) - 1
    seconds = (part.stamps_ns[last] - part.stamps_ns[first]) / 1e9
    spans = part.frames[last] - part.frames[first] + 1
    same = np.diff(part.chains) == 0
    missing = np.diff(part.frames)[same] - 1
    some = len(lengths) > 0
    return {
        "chains": len(lengths),
        "seconds_mean": float(seconds.mean()) if some else None,
        "flickers": int(((missing > 0) & (missing <= MAX_GAP_FRAMES)).sum()),
        "missing_share": float(1 - lengths.sum() / spans.sum()) if some else None,
        "class_changes": int((same & (np.diff(part.class_ids) != 0)).sum()),
        "heading_flips": int((same & is_flip(wrap_angle(np.diff(part.yaws)))).sum()),
    }
