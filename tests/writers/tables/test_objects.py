"""The record of objects: what its rows say of tracks and zones."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from frames import CONFIG, RIG, frame
from pyarrow.parquet import read_table
from tracked_frames import Seen, tracked_frame

from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.writers.outputs.transaction import OutputTransaction
from lidcam.writers.tables.objects import Objects
from lidcam.writers.tables.writer import CsvObjectsWriter

NAMES = CONFIG.object_names
MOTION = ("speed_m_s", "vx_m_s", "vy_m_s", "yaw_rate_rad_s", "existence", "age_s")


def objects_of(*frames: FrameResult, rig: Rig = RIG) -> Objects:
    return join_rows(Objects.empty(rig, NAMES), *(Objects.of_frame(one, rig, NAMES) for one in frames))


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
    output = tmp_path / "run.csv"
    with OutputTransaction([output]) as outputs, CsvObjectsWriter(outputs[output], RIG, NAMES) as writer:
        for one in frames:
            writer.write(one)
    objects_of(*frames).to_csv(tmp_path / "own.csv")
    assert (tmp_path / "own.csv").read_bytes() == output.read_bytes()
    objects_of(*frames).to_parquet(str(tmp_path / "own.parquet"))
    table = read_table(tmp_path / "own.parquet")
    assert table.equals(objects_of(*frames).to_arrow())
    assert json.loads(table.schema.metadata[b"lidcam.objects"]) == {"site_frame": RIG.site_frame}
    with pytest.raises(OutputError, match="expected the name of a file to write, found a folder"):
        objects_of(*frames).to_csv(tmp_path)
