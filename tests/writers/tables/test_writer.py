"""Tables of objects, read back by the libraries that people read them with."""

import gc
import json
import resource
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest
from frames import CONFIG, PROVENANCE, RIG, frame
from pyarrow import parquet
from tracked_frames import Seen, tracked_frame

from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.writers.base import ResultWriter
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.tables import writer as tables
from lidcam.writers.tables.objects import Objects
from lidcam.writers.tables.writer import CsvObjectsWriter, ParquetObjectsWriter

NAMES = CONFIG.object_names
FRAMES = [
    frame(0),
    tracked_frame(1, Seen(1, 2.0, 1 / 3, 5.5), Seen(0, 1e-9, -70.0)),
    tracked_frame(2),
    tracked_frame(3, Seen(12_345_678_901, -2.0, 0.0)),
]
KINDS = ("csv", "parquet")


def writer_of(path: Path) -> ResultWriter:
    output = OutputFile(path, path)
    if path.suffix == ".csv":
        return CsvObjectsWriter(output, RIG, NAMES)
    return ParquetObjectsWriter(output, RIG, NAMES, PROVENANCE)


UNITS = {
    **dict.fromkeys(("frame", "track", "class", "zone", "score", "existence", "front_known"), ""),
    **dict.fromkeys(("points", "cameras", "source"), ""),
    **dict.fromkeys(("x_m", "y_m", "z_m", "length_m", "width_m", "height_m"), "m"),
    **dict.fromkeys(("speed_m_s", "vx_m_s", "vy_m_s"), "m/s"),
    **dict.fromkeys(("stamp_ns", "measured_ns"), "ns"),
    **{"yaw_rad": "rad", "yaw_rate_rad_s": "rad/s", "age_s": "s"},
}


def written(path: Path, frames: Iterable[FrameResult]) -> Path:
    with writer_of(path) as writer:
        for one in frames:
            assert writer.write(one) == ()
    return path


def columns_of(frames: list[FrameResult]) -> dict[str, list[Any]]:
    objects = join_rows(Objects.empty(RIG, NAMES), *(Objects.of_frame(one, RIG, NAMES) for one in frames))
    return {name: column.tolist() for name, column in objects.columns.items()}


@pytest.mark.parametrize("frames", [[], FRAMES[2:3], FRAMES[:1], FRAMES], ids=["none", "empty", "one", "many"])
@pytest.mark.parametrize("kind", KINDS)
def test_pandas_and_polars_read_what_was_found(tmp_path: Path, kind: str, frames: list[FrameResult]) -> None:
    path = written(tmp_path / f"out.{kind}", frames)
    in_pandas = pd.read_csv(path, keep_default_na=False, na_values={"speed_m_s": [""]}) if kind == "csv" else None
    in_polars = pl.read_csv(path) if kind == "csv" else pl.read_parquet(path)
    expected = columns_of(frames)
    assert in_polars.columns == [*expected]
    if in_pandas is None:
        in_pandas = pd.read_parquet(path)
    assert [*in_pandas.columns] == [*expected]
    for name, column in expected.items():
        for found in (in_pandas[name].tolist(), in_polars[name].to_list()):
            plain = [float("nan") if value in (None, "") and name != "zone" else value for value in found]
            if name == "score":
                np.testing.assert_array_equal(np.array(plain, np.float32), np.array(column, np.float32))
            elif column and isinstance(column[0], float):
                np.testing.assert_array_equal(np.array(plain, np.float64), column)
            else:
                assert plain == column


def test_csv_is_short_and_plain(tmp_path: Path) -> None:
    header, row, other = written(tmp_path / "out.csv", FRAMES[1:2]).read_bytes().decode().splitlines()
    cells = dict(zip(header.split(","), row.split(","), strict=True))
    assert (cells["score"], cells["y_m"], cells["speed_m_s"]) == ("0.5", "0.3333333333333333", "5.5")
    assert (cells["front_known"], cells["class"], cells["source"]) == ("true", "car", "lidar")
    assert dict(zip(header.split(","), other.split(","), strict=True))["speed_m_s"] == ""


@pytest.mark.parametrize("kind", KINDS)
def test_equal_results_are_equal_bytes(tmp_path: Path, kind: str) -> None:
    one, other = (written(tmp_path / f"{name}.{kind}", FRAMES).read_bytes() for name in "ab")
    assert one == other


def test_parquet_says_where_it_comes_from(tmp_path: Path) -> None:
    schema = parquet.read_schema(written(tmp_path / "out.parquet", FRAMES))
    metadata = schema.metadata
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in schema}
    assert units == UNITS
    assert schema.field("vx_m_s").metadata[b"frame"] == b"site"
    assert b"frame" not in schema.field("length_m").metadata
    assert json.loads(metadata[b"lidcam.objects"]) == {"site_frame": "site"} | PROVENANCE.metadata()


def test_rows_leave_memory_in_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "GROUP_ROWS", 4)
    path = tmp_path / "out.parquet"
    frames = [frame(row) for row in range(5)]  # of three objects each
    written(path, frames)
    file = parquet.ParquetFile(path)
    assert [file.metadata.row_group(row).num_rows for row in range(file.num_row_groups)] == [6, 6, 3]
    assert file.read(["frame"])["frame"].to_pylist() == columns_of(frames)["frame"]


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Files can be no larger within the block: a disk that is full."""
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [0, 3000])
def test_a_full_disk_is_one_line(tmp_path: Path, kind: str, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "GROUP_ROWS", 100)
    path = tmp_path / f"out.{kind}"
    full = pytest.raises(OutputError, match=rf"out\.{kind}: cannot be written: File too large")
    with full, file_size_limit(size):
        written(path, FRAMES * 50)
    gc.collect()  # whatever is raised there is an error of the test
