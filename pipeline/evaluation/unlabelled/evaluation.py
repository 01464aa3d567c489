"""Figures without truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import I64, Indices
from pipeline.core.rig import CameraSensor, Zone
from pipeline.core.settings.config import Config
from pipeline.evaluation.ignoring import is_within
from pipeline.evaluation.pieces import Pieces
from pipeline.evaluation.records import UNKNOWN, EvaluationFrame, Figures, SourceBoxes, in_order
from pipeline.evaluation.unlabelled.chains import ChainTable, chain_figures
from pipeline.evaluation.unlabelled.counts import ObjectCounts
from pipeline.evaluation.unlabelled.linking import Linker
from pipeline.evaluation.unlabelled.residuals import Residuals
from pipeline.evaluation.unlabelled.smoothness import limits_of, smoothness_figures
from pipeline.evaluation.unlabelled.synchrony import Synchrony

__all__ = ["UnlabelledEvaluation"]


class UnlabelledEvaluation:
    """What results say about themselves: nobody needs to know what was there.

    Places are those of the results: where they are in the frame of a vehicle, motion is relative to the vehicle.

    Args:
        config: Classes; how boxes are matched (`associate`); region and range of what is looked at.
        zones: In which objects are counted.
        cameras: Cameras with calibration.
    """

    def __init__(self, config: Config, zones: Sequence[Zone], cameras: Sequence[CameraSensor]) -> None:
        self._config, self._zones, self._cameras = config, tuple(zones), tuple(cameras)
        self._sources: dict[str, _Source] = {}
        self._residuals: dict[tuple[str, str], Residuals] = {}
        self._synchrony = Synchrony([camera.name for camera in cameras])

    def add(self, frame: EvaluationFrame) -> None:
        """Take in one frame.

        Raises:
            FrameError: boxes are not in the site frame of the cameras.
        """
        self._synchrony.add(frame)
        for name, found in frame.sources.items():
            if name not in self._sources:
                self._sources[name] = _Source(self._config, self._zones)
                for camera in self._cameras:
                    self._residuals[name, camera.name] = Residuals(camera, self._config)
            self._sources[name].add(frame, found)
            for camera in self._cameras:
                if camera.name in frame.images:
                    image = frame.images[camera.name]
                    self._residuals[name, camera.name].add(frame.stamp_ns, found.boxes, image.found)

    def figures(self) -> Figures:
        """`unlabelled.SOURCE` and `sync`."""
        return {
            "unlabelled": {
                name: {
                    **self._sources[name].figures(),
                    "images": {camera.name: self._residuals[name, camera.name].figures() for camera in self._cameras},
                }
                for name in in_order(self._sources)
            },
            "sync": self._synchrony.figures(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Tracks:
    """(N,) int64, track of each box, or `UNKNOWN`."""

    ids: I64


class _Source:
    """The objects of one 3D source."""

    def __init__(self, config: Config, zones: Sequence[Zone]) -> None:
        self._config = config
        self._lengths_m = np.array([prior.size_m[0] for prior in config.classes])
        self._counts = ObjectCounts(config, zones)
        self._linker = Linker(self._lengths_m)
        self._boxes = Pieces(ChainTable.empty())
        self._tracks = Pieces(_Tracks(np.zeros(0, np.int64)))

    def add(self, frame: EvaluationFrame, found: SourceBoxes) -> None:
        found = found.select(is_within(found.boxes.centers, self._config.evaluate))
        boxes = found.boxes
        self._counts.add(frame.stamp_ns, boxes)
        self._tracks.append(_Tracks(found.track_ids))
        self._boxes.append(
            ChainTable(
                self._linker.link(frame.index, boxes, frame.stamp_ns),
                np.full(len(boxes), frame.index, np.int64),
                np.full(len(boxes), frame.stamp_ns, np.int64),
                boxes.centers[:, :2],
                boxes.sizes,
                boxes.yaws,
                boxes.class_ids.astype(np.int64),
            )
        )

    def figures(self) -> Figures:
        boxes, tracks = self._boxes.table(), self._tracks.table().ids
        has_tracks = bool((tracks != UNKNOWN).any())
        table = _chained(boxes, tracks if has_tracks else boxes.chains)
        return {
            "objects": self._counts.figures(),
            "chains_by": "track" if has_tracks else "place",
            "boxes_without_track": int((tracks == UNKNOWN).sum()) if has_tracks else 0,
            "chains": {
                **{name: self._of_chains(table, class_id) for class_id, name in enumerate(self._config.class_names)},
                "all": self._of_chains(table, None),
            },
        }

    def _of_chains(self, table: ChainTable, class_id: int | None) -> Figures:
        """The figures of the chains of a class, or of all (None)."""
        part = table if class_id is None else table.of_chains(table.main_classes() == class_id)
        return {
            **limits_of(None if class_id is None else float(self._lengths_m[class_id])),
            **chain_figures(part),
            **smoothness_figures(part, self._lengths_m),
        }


def _chained(boxes: ChainTable, names: I64) -> ChainTable:
    """The boxes that have a name, by name, then by time; a chain ends where time does not rise."""
    rows: Indices = np.flatnonzero(names != UNKNOWN)
    rows = rows[np.lexsort((boxes.frames[rows], names[rows]))]
    starts = np.ones(len(rows), np.bool_)
    starts[1:] = (np.diff(names[rows]) != 0) | (np.diff(boxes.stamps_ns[rows]) <= 0)
    return replace(boxes.select(rows), chains=(np.cumsum(starts) - 1).astype(np.int64))
