"""The fused objects as a table: the record, and the columns that it has in every library and file."""

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import IO, Any, ClassVar, Self, overload

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, U8, Array, Bools, CheckedTable, Rows, join_rows
from lidcam.pipeline.core.detections import source_names
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import OBJECTS
from lidcam.writers.outputs.transaction import OutputTransaction

MAX_SHOWN = 10
"""Rows that the text form shows."""

MAX_SCROLLED = 1000
"""Rows that the form for notebooks has."""

SHOWN_COLUMNS = ("frame", "track", "class", "zone", "x_m", "y_m", "yaw_rad", "speed_m_s", "score")
"""Columns that it shows: what fits a terminal of 80 columns."""

UNITS = {"_m_s": "m/s", "_rad_s": "rad/s", "_m": "m", "_rad": "rad", "_ns": "ns", "_s": "s"}
"""By the end of a column's name; the first that fits."""

IN_SITE = frozenset({"x_m", "y_m", "z_m", "yaw_rad", "vx_m_s", "vy_m_s"})
"""Columns that are given in the site frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Objects(CheckedTable):
    """N fused objects, one row per object and frame, in the order of the frames.

    `objects[3]`, and each of a loop, is one of them by the names of `columns`; `objects[10:20]`,
    `objects[objects.classes == "car"]` and `objects + others` are `Objects` again.

    Where an object belongs to no track, `velocities`, `yaw_rates`, `existence` and `ages_s` are NaN: 0 would say that
    it stands.

    Attributes:
        frame_id: The site frame, in which the objects are given.
        class_names: Name by class id.
        zone_names: Name by zone; the last is that of what is outside of all zones, empty where there are none.
        frames: (N,) int64, index of the frame.
        stamps_ns: (N,) int64, time of the frame.
        class_ids: (N,) int32, index into `class_names`.
        zones: (N,) int64, index into `zone_names` of the first zone that holds the centre; -1 outside.
        scores: (N,) float32 in [0, 1].
        centers: (N, 3) float64, box centre x, y, z in metres.
        sizes: (N, 3) float64, length, width, height in metres.
        yaws: (N,) float64, radians about +z in (-pi, pi].
        point_counts: (N,) int32, lidar points in the object.
        matched: (N,) int32, number of cameras that confirm it.
        covariances: (N, 3, 3) float64 over x, y and yaw.
        sources: (N,) uint8, the `Source` of each object's geometry.
        measured_ns: (N,) int64, when the object was there: the stamp of the frame for tracked objects, else the mean
            time of its points or images.
        tracks: (N,) int64, number of its track from 1, the same in all frames; 0 where it belongs to none.
        velocities: (N, 2) float64, over the ground, along x and y of the site frame, m/s.
        yaw_rates: (N,) float64, over the ground, rad/s, counter-clockwise.
        existence: (N,) float64 in [0, 1], probability that the track is an object of its class.
        ages_s: (N,) float64, since the track was first seen.
        fronts_known: (N,) bool, whether its motion has shown which end is its front.
        moving: (N,) bool, whether it moves: at 0.3 m/s or more, and beyond the uncertainty of its velocity.
    """

    ROWS: ClassVar = {"centers": (3,), "sizes": (3,), "covariances": (3, 3), "velocities": (2,)}

    frame_id: str
    class_names: tuple[str, ...]
    zone_names: tuple[str, ...]
    frames: I64
    stamps_ns: I64
    class_ids: I32
    zones: I64
    scores: F32
    centers: F64
    sizes: F64
    yaws: F64
    point_counts: I32
    matched: I32
    covariances: F64
    sources: U8
    measured_ns: I64
    tracks: I64
    velocities: F64
    yaw_rates: F64
    existence: F64
    ages_s: F64
    fronts_known: Bools
    moving: Bools

    @classmethod
    def empty(cls, rig: Rig, class_names: tuple[str, ...]) -> Self:
        """No objects."""
        return cls.zeros(frame_id=rig.site_frame, class_names=class_names, zone_names=rig.place_names)

    @classmethod
    def of_frame(cls, result: FrameResult, rig: Rig, class_names: tuple[str, ...]) -> Self:
        """The objects of one frame."""
        fused, boxes, count = result.fused, result.fused.objects, len(result.fused.objects)
        tracks = Tracks.none(count) if fused.tracks is None else fused.tracks
        unknown = np.where(tracks.ids == NO_TRACK, np.nan, 0.0)
        return cls(
            frame_id=boxes.frame_id,
            class_names=class_names,
            zone_names=rig.place_names,
            frames=np.full(count, result.bundle.index, np.int64),
            stamps_ns=np.full(count, result.bundle.stamp_ns, np.int64),
            class_ids=boxes.class_ids,
            zones=rig.place_rows(boxes.centers),
            scores=boxes.scores,
            centers=boxes.centers,
            sizes=boxes.sizes,
            yaws=boxes.yaws,
            point_counts=boxes.point_counts,
            matched=fused.matched,
            covariances=boxes.covariances,
            sources=boxes.sources,
            measured_ns=boxes.measured_ns,
            tracks=tracks.ids,
            velocities=tracks.motions[:, :2] + unknown[:, None],
            yaw_rates=tracks.motions[:, 2] + unknown,
            existence=tracks.existence + unknown,
            ages_s=tracks.ages_s + unknown,
            fronts_known=tracks.fronts_known,
            moving=tracks.moving,
        )

    @overload
    def __getitem__(self, rows: int | np.integer[Any]) -> dict[str, Any]: ...

    @overload
    def __getitem__(self, rows: slice | Rows | list[int]) -> "Objects": ...

    def __getitem__(self, rows: Any) -> "Objects | dict[str, Any]":
        if isinstance(rows, int | np.integer):
            row = range(len(self))[rows]  # which raises an IndexError, and counts from the end
            return next(iter(self.select(np.array([row]))))
        return self.select(np.arange(len(self))[rows])

    def __iter__(self) -> Iterator[dict[str, Any]]:
        names = [*self.columns]
        for values in zip(*(column.tolist() for column in self.columns.values()), strict=True):
            yield dict(zip(names, values, strict=True))

    def __add__(self, other: "Objects") -> "Objects":
        for name in ("frame_id", "class_names", "zone_names"):
            if getattr(self, name) != getattr(other, name):
                raise ValueError(f"expected objects with {name} {getattr(self, name)}, found {getattr(other, name)}")
        return join_rows(self, other)

    @property
    def classes(self) -> Array:
        """(N,) str, the name of each object's class."""
        return np.array(self.class_names, np.str_)[self.class_ids]

    @property
    def speeds(self) -> F64:
        """(N,) over the ground, m/s; NaN where an object belongs to no track."""
        return np.hypot(self.velocities[:, 0], self.velocities[:, 1])

    @property
    def speeds_km_h(self) -> F64:
        """(N,) the same in km/h."""
        return 3.6 * self.speeds

    @property
    def columns(self) -> Mapping[str, Array]:
        """The table by columns, each (N,): frame, stamp_ns, track, class, x_m and so on, with units in their names.

        `source` is what the geometry comes from: `lidar`, `camera`, `both` or `predicted`. Of an object without track
        the columns of motion are NaN.
        """
        x, y, z = self.centers.T
        length, width, height = self.sizes.T
        vx, vy = self.velocities.T
        return {
            "frame": self.frames,
            "stamp_ns": self.stamps_ns,
            "track": self.tracks,
            "class": self.classes,
            "zone": np.array(self.zone_names, np.str_)[self.zones],
            "score": self.scores,
            "x_m": x,
            "y_m": y,
            "z_m": z,
            "length_m": length,
            "width_m": width,
            "height_m": height,
            "yaw_rad": self.yaws,
            "speed_m_s": self.speeds,
            "vx_m_s": vx,
            "vy_m_s": vy,
            "yaw_rate_rad_s": self.yaw_rates,
            "existence": self.existence,
            "age_s": self.ages_s,
            "front_known": self.fronts_known,
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
        """The columns as a pyarrow.Table, units and frames in the metadata of its fields."""
        arrow = _library("pyarrow")
        table = arrow.table(dict(self.columns))
        fields = [field.with_metadata(_column_metadata(field.name, self.frame_id)) for field in table.schema]
        return arrow.Table.from_arrays(table.columns, schema=arrow.schema(fields))

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the columns as CSV, as `lidcam process --objects OUT.csv` does; what stands there is replaced.

        Raises:
            OutputError: it cannot be written.
        """
        path = Path(path)
        with (
            OutputTransaction([path]) as outputs,
            output_errors(path),
            outputs[path].part.open("x", encoding="utf-8", newline="") as file,
        ):
            file.write(self.csv_header)
            self.write_rows(file)

    def to_parquet(self, path: str | PathLike[str]) -> None:
        """Write the columns as Parquet, as `lidcam process --objects OUT.parquet` does; what stands there is replaced.

        Raises:
            OutputError: it cannot be written.
        """
        from pyarrow import parquet  # takes a quarter of a second, and starts threads

        path, table = Path(path), self.to_arrow().replace_schema_metadata(parquet_metadata(self.frame_id, {}))
        with OutputTransaction([path]) as outputs, output_errors(path):
            parquet.write_table(table, outputs[path].part, compression="zstd")

    @property
    def csv_header(self) -> str:
        """First line of a CSV table, by which it is known."""
        return ",".join(self.columns) + "\n"

    def write_rows(self, file: IO[str]) -> None:
        """Write rows of CSV: numbers as short as they can be without loss, `true` and `false`, nothing for NaN."""
        rows = zip(*map(_cells, self.columns.values()), strict=True)
        csv.writer(file, lineterminator="\n").writerows(rows)

    def __repr__(self) -> str:
        rows = [SHOWN_COLUMNS, *self._texts(SHOWN_COLUMNS, MAX_SHOWN)] if len(self) else []
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.rjust, row, widths)) for row in rows]
        return "\n".join(filter(None, [self._head, *lines, self._foot(MAX_SHOWN)]))

    def _repr_html_(self) -> str:
        """For notebooks: the first rows, which scroll below the names of the columns, in the notebook's colours."""
        cell = 'style="text-align: right; white-space: nowrap; padding: 0.1em 0.6em"'
        top = 'style="position: sticky; top: 0; background: var(--jp-layout-color1, Canvas)"'
        names = tuple(self.columns)
        body = "".join(
            f"<tr>{''.join(f'<td {cell}>{escape(text)}</td>' for text in row)}</tr>"
            for row in self._texts(names, MAX_SCROLLED)
        )
        names_row = "".join(f"<th {cell}>{escape(name)}</th>" for name in names)
        return (
            f"<div>{escape(self._head)}</div>"
            '<div style="max-height: 22em; overflow: auto; max-width: 100%">'
            f"<table><thead {top}><tr>{names_row}</tr></thead><tbody>{body}</tbody></table></div>"
            f"<div>{escape(self._foot(MAX_SCROLLED))}</div>"
        )

    @property
    def _head(self) -> str:
        return f"{len(self)} objects, site frame {self.frame_id!r}"

    def _foot(self, shown: int) -> str:
        return f"... {len(self) - shown} more" if len(self) > shown else ""

    def _texts(self, names: tuple[str, ...], count: int) -> Iterator[list[str]]:
        columns = self.select(np.arange(min(len(self), count))).columns
        return ([*map(_text, row)] for row in zip(*(columns[name] for name in names), strict=True))


def _column_metadata(name: str, site_frame: str) -> dict[str, str]:
    """Metadata of a column: its `unit`, and the `frame` in which it is given; none where it has none."""
    unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
    facts = {"unit": unit, "frame": site_frame if name in IN_SITE else ""}
    return {key: value for key, value in facts.items() if value}


def parquet_metadata(site_frame: str, origin: Mapping[str, str]) -> dict[str, str]:
    """The metadata of a Parquet table: under `lidcam.objects`, as JSON, the site frame and where it comes from."""
    return {OBJECTS: json.dumps({"site_frame": site_frame, **origin})}


def _cells(column: Array) -> list[Any]:
    if column.dtype == np.bool_:
        return ["true" if value else "false" for value in column.tolist()]
    if column.dtype.kind == "f":
        return ["" if text == "nan" else text for text in column.astype(np.str_).tolist()]
    return list(column.tolist())


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as err:
        raise ImportError(f"this table needs {name}, which is not installed: pip install {name}") from err


def _text(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float | np.floating) else str(value)
