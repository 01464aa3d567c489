from io import StringIO

import pytest
from rich.console import Console, RenderableType

from lidcam.checks.missing import MissingSensor, SilentSpan
from lidcam.printing.tables import missing_table, objects_table, sensors_table, stages_table
from readers.rig.calibration import SensorSource

OBJECTS = {("car", "north"): 6, ("car", "outside"): 1, ("bus", "south"): 3}


def text(table: RenderableType) -> list[str]:
    with StringIO() as out:
        Console(file=out, width=200).print(table)
        return [line.rstrip() for line in out.getvalue().splitlines()]


def test_objects_by_zone() -> None:
    assert text(objects_table(OBJECTS, ["north", "south"], 4)) == [
        "class  north  south  outside  all  a frame",
        "bus        0      3        0    3      0.8",
        "car        6      0        1    7      1.8",
    ]


@pytest.mark.parametrize(("frames", "mean"), [(1, "3.0"), (20, "0.1"), (0, "3.0")])
def test_without_zones_there_are_no_columns_of_them(frames: int, mean: str) -> None:
    found = text(objects_table({("car", ""): 3}, [], frames))
    assert found[0].split() == ["class", "all", "a", "frame"]
    assert found[1].split() == ["car", "3", mean]


def test_no_objects() -> None:
    assert text(objects_table({}, [], 5))[1].split() == ["none", "0", "0.0"]
    assert text(objects_table({}, ["a"], 5))[1].split() == ["none", "0", "0", "0", "0.0"]


def test_sensors_with_a_time_offset_have_a_column_of_it() -> None:
    lidar = SensorSource("top", "/points", "velodyne", "", "rig file")
    camera = SensorSource("cam", "/image", "cam", "rig file", "rig file", -35.5)
    assert "time offset" not in text(sensors_table([lidar]))[1]
    _, header, *rows = text(sensors_table([lidar, camera]))
    assert header.endswith("time offset")
    assert [row.endswith("-35.5 ms") for row in rows] == [False, True]


def test_missing_sensors() -> None:
    silent = MissingSensor("cam11", "/image_11", 20, 30, (SilentSpan(1.0, None, 20),))
    slow = MissingSensor("cam3", "/image_3", 15, 30, ())
    assert text(missing_table([silent, slow])) == [
        "missing from frames",
        "sensor  frames  when",
        "cam11       20  silent from 1.0 s to the end",
        "cam3        15  in 15 of 30 frames",
    ]


def test_a_camera_and_its_boxes_are_one_row_if_they_agree() -> None:
    def missing(sensor: str, frames: int) -> MissingSensor:
        return MissingSensor(sensor, f"/{sensor}", frames, 30, ())

    found = [
        missing("a", 7),
        missing("b", 7),
        missing("a (boxes)", 7),
        missing("b (boxes)", 9),
        missing("c (boxes)", 7),
    ]
    assert [row.split("  ")[0] for row in text(missing_table(found))[2:]] == [
        "a and its boxes",
        "b",
        "b (boxes)",
        "c (boxes)",
    ]
    assert text(missing_table([]))[2:] == []


def test_stages_that_take_no_time_are_not_in_the_table() -> None:
    found = text(stages_table({"combine": 0.02, "no 2D boxes": 0.0001, "write": 0.0006}, 10))
    assert [line.split()[0] for line in found[2:]] == ["combine", "write"]
    assert [line.split()[-1] for line in found[2:]] == ["2.0", "0.1"]
