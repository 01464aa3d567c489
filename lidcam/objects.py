"""The fused objects of a run as one table of arrays, for notebooks."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from lidcam.frames import RunInput
from lidcam.run import RunObserver
from pipeline.core.arrays import F32, F64, I32, I64, U8, Array, Rows, check_array, select_rows
from pipeline.core.detections import source_names
from pipeline.core.frame import FrameResult

__all__ = ["ObjectCollector", "Objects"]

MAX_SHOWN = 10
"""Rows that the text form shows."""


@dataclass(frozen=True, slots=True, eq=False)
class Objects:
    """N fused objects, one row per object and frame, in the order of the frames.

    Attributes:
        frame_id: The site frame, in which the objects are given.
        class_names: Name by class id.
        frames: (N,) int64, index of the frame.
        stamps_ns: (N,) int64, time of the frame.
        class_ids: (N,) int32, index into `class_names`.
        scores: (N,) float32 in [0, 1].
        centers: (N, 3) float64, box centre x, y, z in metres.
        sizes: (N, 3) float64, length, width, height in metres.
        yaws: (N,) float64, radians about +z in (-pi, pi].
        point_counts: (N,) int32, lidar points in the object.
        matched: (N,) int32, number of cameras that confirm it.
        covariances: (N, 3, 3) float64 over x, y and yaw.
        sources: (N,) uint8, the `Source` of each object's geometry.
        measured_ns: (N,) int64, when the object was there: mean time of its points or images.
    """

    frame_id: str
    class_names: tuple[str, ...]
    frames: I64
    stamps_ns: I64
    class_ids: I32
    scores: F32
    centers: F64
    sizes: F64
    yaws: F64
    point_counts: I32
    matched: I32
    covariances: F64
    sources: U8
    measured_ns: I64

    def __post_init__(self) -> None:
        n = len(self.scores)
        check_array("frames", self.frames, (n,), np.int64)
        check_array("stamps_ns", self.stamps_ns, (n,), np.int64)
        check_array("class_ids", self.class_ids, (n,), np.int32)
        check_array("scores", self.scores, (n,), np.float32)
        check_array("centers", self.centers, (n, 3), np.float64)
        check_array("sizes", self.sizes, (n, 3), np.float64)
        check_array("yaws", self.yaws, (n,), np.float64)
        check_array("point_counts", self.point_counts, (n,), np.int32)
        check_array("matched", self.matched, (n,), np.int32)
        check_array("covariances", self.covariances, (n, 3, 3), np.float64)
        check_array("sources", self.sources, (n,), np.uint8)
        check_array("measured_ns", self.measured_ns, (n,), np.int64)

    def __len__(self) -> int:
        return len(self.scores)

    def select(self, rows: Rows) -> "Objects":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)

    @property
    def columns(self) -> Mapping[str, Array]:
        """The table by columns, each (N,): frame, stamp_ns, class, score, x_m, y_m, z_m, length_m and so on.

        `source` is what the geometry comes from: `lidar`, `camera` or `both`.
        """
        x, y, z = self.centers.T
        length, width, height = self.sizes.T
        return {
            "frame": self.frames,
            "stamp_ns": self.stamps_ns,
            "class": np.array(self.class_names)[self.class_ids],
            "score": self.scores,
            "x_m": x,
            "y_m": y,
            "z_m": z,
            "length_m": length,
            "width_m": width,
            "height_m": height,
            "yaw_rad": self.yaws,
            "points": self.point_counts,
            "cameras": self.matched,
            "source": np.array(source_names(self.sources), np.str_),
            "measured_ns": self.measured_ns,
        }

    def to_pandas(self) -> Any:
        """The columns as a pandas.DataFrame.

        Raises:
            ImportError: pandas is not installed.
        """
        return _library("pandas").DataFrame(dict(self.columns))

    def to_polars(self) -> Any:
        """The columns as a polars.DataFrame.

        Raises:
            ImportError: polars is not installed.
        """
        return _library("polars").DataFrame(dict(self.columns))

    def to_arrow(self) -> Any:
        """The columns as a pyarrow.Table.

        Raises:
            ImportError: pyarrow is not installed.
        """
        return _library("pyarrow").table(dict(self.columns))

    def __repr__(self) -> str:
        head = f"{len(self)} objects, site frame {self.frame_id!r}"
        if not len(self):
            return head
        shown = {name: column[:MAX_SHOWN] for name, column in self.columns.items()}
        texts = [[name, *(_text(value) for value in column)] for name, column in shown.items()]
        widths = [max(map(len, column)) for column in texts]
        lines = [
            "  ".join(text.rjust(w) for text, w in zip(row, widths, strict=True)) for row in zip(*texts, strict=True)
        ]
        more = [f"... {len(self) - MAX_SHOWN} more"] if len(self) > MAX_SHOWN else []
        return "\n".join([head, *lines, *more])


class ObjectCollector(RunObserver):
    """Gathers the objects of a run; memory grows with their number, by about 250 bytes each."""

    def __init__(self) -> None:
        self._class_names: tuple[str, ...] = ()
        self._results: list[tuple[int, int, Any]] = []

    def opened(self, source: RunInput) -> None:
        """Learn the names of the classes."""
        self._class_names = source.config.object_names

    def frame(self, result: FrameResult) -> None:
        """Keep the objects of one frame."""
        self._results.append((result.bundle.index, result.bundle.stamp_ns, result.fused))

    @property
    def objects(self) -> Objects:
        """The objects of the frames so far."""
        boxes = [fused.objects for _, _, fused in self._results]
        counts = [len(box) for box in boxes]

        def joined(name: str, empty: Array) -> Any:
            return np.concatenate([empty, *(getattr(box, name) for box in boxes)])

        return Objects(
            frame_id=boxes[0].frame_id if boxes else "",
            class_names=self._class_names,
            frames=np.repeat(np.array([index for index, _, _ in self._results], np.int64), counts),
            stamps_ns=np.repeat(np.array([stamp_ns for _, stamp_ns, _ in self._results], np.int64), counts),
            class_ids=joined("class_ids", np.zeros(0, np.int32)),
            scores=joined("scores", np.zeros(0, np.float32)),
            centers=joined("centers", np.zeros((0, 3))),
            sizes=joined("sizes", np.zeros((0, 3))),
            yaws=joined("yaws", np.zeros(0)),
            point_counts=joined("point_counts", np.zeros(0, np.int32)),
            matched=np.concatenate([np.zeros(0, np.int32), *(fused.matched for _, _, fused in self._results)]),
            covariances=joined("covariances", np.zeros((0, 3, 3))),
            sources=joined("sources", np.zeros(0, np.uint8)),
            measured_ns=joined("measured_ns", np.zeros(0, np.int64)),
        )


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as err:
        raise ImportError(f"this table needs {name}, which is not installed: pip install {name}") from err


def _text(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float | np.floating) else str(value)
