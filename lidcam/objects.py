"""The fused objects of a run as one table of arrays, for notebooks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from lidcam.frames import RunInput
from lidcam.run import RunObserver
from pipeline.core.arrays import F32, F64, I32, I64, U8, Array, Rows, check_array, select_rows
from pipeline.core.detections import Fused, source_names
from pipeline.core.frame import FrameResult

__all__ = ["ObjectCollector", "Objects"]

MAX_SHOWN = 10
"""Rows that the text form shows."""

ARRAYS: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
    "frames": ((), np.int64),
    "stamps_ns": ((), np.int64),
    "class_ids": ((), np.int32),
    "scores": ((), np.float32),
    "centers": ((3,), np.float64),
    "sizes": ((3,), np.float64),
    "yaws": ((), np.float64),
    "point_counts": ((), np.int32),
    "matched": ((), np.int32),
    "covariances": ((3, 3), np.float64),
    "sources": ((), np.uint8),
    "measured_ns": ((), np.int64),
}
"""Shape of a row, and dtype, of the columns of `Objects`."""


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
        for name, (shape, dtype) in ARRAYS.items():
            check_array(name, getattr(self, name), (len(self.scores), *shape), dtype)

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

    def __init__(self, on_frame: Callable[[FrameResult], None] | None = None) -> None:
        """Gather objects; `on_frame` is called with each frame."""
        self._class_names: tuple[str, ...] = ()
        self._results: list[tuple[int, int, Fused]] = []
        self._on_frame = on_frame

    def opened(self, source: RunInput) -> None:
        """Take over the names of the classes."""
        self._class_names = source.config.object_names

    def frame(self, result: FrameResult) -> None:
        """Take over the objects of one frame."""
        self._results.append((result.bundle.index, result.bundle.stamp_ns, result.fused))
        if self._on_frame is not None:
            self._on_frame(result)

    @property
    def objects(self) -> Objects:
        """The objects of the frames so far."""
        boxes = [fused.objects for _, _, fused in self._results]
        columns: dict[str, list[Any]] = {
            "frames": [np.full(len(fused.objects), index) for index, _, fused in self._results],
            "stamps_ns": [np.full(len(fused.objects), stamp_ns) for _, stamp_ns, fused in self._results],
            "matched": [fused.matched for _, _, fused in self._results],
        }
        columns |= {name: [getattr(box, name) for box in boxes] for name in ARRAYS if name not in columns}
        empty = {name: np.zeros((0, *shape), dtype) for name, (shape, dtype) in ARRAYS.items()}
        return Objects(
            boxes[0].frame_id if boxes else "",
            self._class_names,
            **{name: np.concatenate([empty[name], *columns[name]]) for name in ARRAYS},
        )


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as err:
        raise ImportError(f"this table needs {name}, which is not installed: pip install {name}") from err


def _text(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float | np.floating) else str(value)
