"""Tables of objects: what their rows say of tracks and zones, and the files, read back by the libraries of people."""

import gc
import json
import resource
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
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
from lidcam.pipeline.core.rig import Rig
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


UNITS = {
    **dict.fromkeys(("frame", "track", "class", "zone", "score", "existence", "front_known"), ""),
    **dict.fromkeys(("points", "cameras", "source"), ""),
    **dict.fromkeys(("x_m", "y_m", "z_m", "length_m", "width_m", "height_m"), "m"),
    **dict.fromkeys(("speed_m_s", "vx_m_s", "vy_m_s"), "m/s"),
    **dict.fromkeys(("stamp_ns", "measured_ns"), "ns"),
    **{"yaw_rad": "rad", "yaw_rate_rad_s": "rad/s", "age_s": "s"},
}


def written(path: Path, frames: Iterable[FrameResult]) -> Path:
    given, is_csv = (OutputFile(path, path), RIG, NAMES), path.suffix == ".csv"
    with CsvObjectsWriter(*given) if is_csv else ParquetObjectsWriter(*given, PROVENANCE) as writer:
        for one in frames:
            assert writer.write(one) == ()
    return path


def objects_of(*frames: FrameResult, rig: Rig = RIG) -> Objects:
    return join_rows(Objects.empty(rig, NAMES), *(Objects.of_frame(one, rig, NAMES) for one in frames))


def columns_of(frames: list[FrameResult]) -> dict[str, list[Any]]:
    return {name: column.tolist() for name, column in objects_of(*frames).columns.items()}


@pytest.mark.parametrize("frames", [[], FRAMES[2:3], FRAMES[:1], FRAMES], ids=["none", "empty", "one", "many"])
@pytest.mark.parametrize("kind", KINDS)
def test_pandas_and_polars_read_what_was_found(tmp_path: Path, kind: str, frames: list[FrameResult]) -> None:
    path, expected = written(tmp_path / f"out.{kind}", frames), columns_of(frames)
    if kind == "csv":
        in_pandas = pd.read_csv(path, keep_default_na=False, na_values={"speed_m_s": [""]})
        in_polars = pl.read_csv(path)
    else:
        in_pandas, in_polars = pd.read_parquet(path), pl.read_parquet(path)
    assert [*in_pandas.columns] == in_polars.columns == [*expected]
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


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "GROUP_ROWS", 100)
    for kind, size in product(KINDS, (0, 3000)):
        full = pytest.raises(OutputError, match=rf"{size}\.{kind}: cannot be written: File too large")
        with full, file_size_limit(size):
            written(tmp_path / f"{size}.{kind}", FRAMES * 50)
    gc.collect()  # whatever is raised there is an error of the test


MOTION = ("speed_m_s", "vx_m_s", "vy_m_s", "yaw_rate_rad_s", "existence", "age_s")


def test_objects_of_tracks() -> None:
    objects = objects_of(tracked_frame(3, Seen(4, 1, 2, -2.5), Seen(0, 1, -2, 7.0)), tracked_frame(5, Seen(4, 1, -90)))
    columns = objects.columns
    assert columns["frame"].tolist() == [3, 3, 5]
    assert columns["track"].tolist() == [4, 0, 4]
    assert columns["zone"].tolist() == ["intersection", "circle", "outside"]
    assert [columns[name][0].item() for name in MOTION] == [2.5, -2.5, 0.0, 0.125, 0.75, 0.3]
    assert all(np.isnan(columns[name][1]) for name in MOTION)  # it belongs to no track
    assert columns["front_known"].tolist() == [True] * 3
    assert objects.speeds[2] == 0.0


@pytest.mark.parametrize("count", [0, 1, 3])
def test_objects_without_tracks(count: int) -> None:
    columns = objects_of(frame(objects=count), rig=replace(RIG, zones=())).columns
    assert {len(column) for column in columns.values()} == {count}
    assert columns["track"].tolist() == [0] * count
    assert not columns["front_known"].any()
    assert columns["zone"].tolist() == [""] * count
    assert all(np.isnan(columns[name]).all() for name in MOTION)


def test_columns_have_the_same_types_however_many_objects_there_are() -> None:
    none, some = objects_of().to_arrow(), objects_of(tracked_frame(0, Seen(1, 2, 3))).to_arrow()
    assert none.schema == some.schema
    assert (none.num_rows, some.num_rows) == (0, 1)


def test_arrays_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"velocities: expected float64\[1, 2\]"):
        replace(objects_of(tracked_frame(0, Seen(1, 2, 3))), velocities=np.zeros((1, 3)))


def test_rows_are_indexed_looped_over_and_added() -> None:
    objects = objects_of(tracked_frame(3, Seen(4, 1, 2, -2.5), Seen(5, 1, -2, 7.0)), tracked_frame(5, Seen(4, 1, -90)))
    rows = [*objects]
    assert [row["track"] for row in rows] == [4, 5, 4]
    assert objects[1] == rows[1] == objects[-2]
    assert list(rows[0]) == list(objects.columns)
    with pytest.raises(IndexError):
        objects[3]
    for part in (objects[objects.tracks == 4], objects[[0, 2]], objects[::2]):
        assert part.columns["frame"].tolist() == [3, 5]
    both = objects + objects[:1]
    assert both.tracks.tolist() == [4, 5, 4, 4]
    with pytest.raises(ValueError, match=r"expected objects with zone_names .*outside.*, found"):
        objects + replace(objects, zone_names=("",))


def test_tables_from_python_are_those_of_a_run(tmp_path: Path) -> None:
    frames = [tracked_frame(0, Seen(1, 2, 3), Seen(2, 1, -2)), tracked_frame(1)]
    output = written(tmp_path / "run.csv", frames)
    objects_of(*frames).to_csv(tmp_path / "own.csv")
    assert (tmp_path / "own.csv").read_bytes() == output.read_bytes()
    objects_of(*frames).to_parquet(str(tmp_path / "own.parquet"))
    table = parquet.read_table(tmp_path / "own.parquet")
    assert table.equals(objects_of(*frames).to_arrow())
    assert json.loads(table.schema.metadata[b"lidcam.objects"]) == {"site_frame": RIG.site_frame}
    with pytest.raises(OutputError, match="expected the name of a file to write, found a folder"):
        objects_of(*frames).to_csv(tmp_path)
