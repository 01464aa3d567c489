"""The table of objects as a file: the forms that runs and notebooks write."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from lidcam.pipeline.core.arrays import Array
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import OBJECTS
from lidcam.writers.outputs.transaction import OutputTransaction

UNITS = {"_m_s": "m/s", "_rad_s": "rad/s", "_m": "m", "_rad": "rad", "_ns": "ns", "_s": "s"}
"""By the end of a column's name; the first that fits."""

IN_SITE = frozenset({"x_m", "y_m", "z_m", "yaw_rad", "vx_m_s", "vy_m_s"})
"""Columns that are given in the site frame."""


def column_metadata(name: str, site_frame: str) -> dict[str, str]:
    """Metadata of a column: its `unit`, and the `frame` in which it is given; none where it has none."""
    unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
    facts = {"unit": unit, "frame": site_frame if name in IN_SITE else ""}
    return {key: value for key, value in facts.items() if value}


def csv_header(columns: Mapping[str, Array]) -> str:
    """First line of a CSV table, by which it is known."""
    return ",".join(columns) + "\n"


def write_rows(file: IO[str], columns: Mapping[str, Array]) -> None:
    """Write N rows of CSV: numbers as short as they can be without loss, `true` and `false`, nothing for NaN."""
    csv.writer(file, lineterminator="\n").writerows(zip(*map(_texts, columns.values()), strict=True))


def parquet_metadata(site_frame: str, origin: Mapping[str, str]) -> dict[str, str]:
    """The metadata of a Parquet table: under `lidcam.objects`, as JSON, the site frame and where it comes from."""
    return {OBJECTS: json.dumps({"site_frame": site_frame, **origin})}


def save_csv(path: Path, columns: Mapping[str, Array]) -> None:
    """Write a whole table, in UTF-8, in place of what stands there.

    Raises:
        OutputError: it cannot be written.
    """
    with (
        OutputTransaction([path]) as outputs,
        output_errors(path),
        outputs[path].part.open("x", encoding="utf-8", newline="") as file,
    ):
        file.write(csv_header(columns))
        write_rows(file, columns)


def save_parquet(path: Path, table: Any, site_frame: str) -> None:
    """Write a whole pyarrow.Table, in place of what stands there.

    Raises:
        OutputError: it cannot be written.
    """
    from pyarrow import parquet  # takes a quarter of a second, and starts threads

    with OutputTransaction([path]) as outputs, output_errors(path):
        parquet.write_table(
            table.replace_schema_metadata(parquet_metadata(site_frame, {})), outputs[path].part, compression="zstd"
        )


def _texts(column: Array) -> list[Any]:
    if column.dtype == np.bool_:
        return ["true" if value else "false" for value in column.tolist()]
    if column.dtype.kind == "f":
        return ["" if text == "nan" else text for text in column.astype(np.str_).tolist()]
    return list(column.tolist())
