from io import StringIO

import numpy as np
import pytest
from rich.console import Console, RenderableType

from lidcam.cli.printing.numbers import number, percent, share, signed
from lidcam.cli.printing.tables import missing_table, objects_table, road_users_table, sensors_table
from lidcam.pipeline.evaluation.road_users import RoadUserCount, RoadUsers
from lidcam.readers.rig.calibration import SensorSource
from lidcam.run.missing import MissingSensor, SilentSpan

OBJECTS = {("car", "north"): 6, ("car", "outside"): 1, ("bus", "south"): 3}


def text(table: RenderableType) -> list[str]:
    with StringIO() as out:
        Console(file=out, width=200).print(table)
        return [line.rstrip() for line in out.getvalue().splitlines()]


def test_objects_by_zone() -> None:
    assert text(objects_table(OBJECTS, ["north", "south"], 4)) == [
        "class  north  south  outside  all  per frame",
        "bus        0      3        0    3        0.8",
        "car        6      0        1    7        1.8",
    ]


USERS = RoadUsers(
    (
        RoadUserCount("car", "north", 12, 11, 1, 8.25, 13.94),
        RoadUserCount("car", "outside", 1, 0, 1, np.nan, np.nan),
        RoadUserCount("car", "", 12, 11, 1, 8.0, 13.94),
        RoadUserCount("pedestrian", "", 3, 2, 0, 1.31, 2.0),
    ),
    (),
)


def test_road_users_by_zone() -> None:
    assert text(road_users_table(USERS, ["north", "south"])) == [
        "road users",
        "class       zone     number  moved  mean m/s  max m/s",
        "car         north        12     11       8.2     13.9",
        "            outside       1      0",
        "            all          12     11       8.0     13.9",
        "pedestrian  all           3      2       1.3      2.0",
    ]


def test_sensors_with_a_time_offset_have_a_column_of_it() -> None:
    lidar = SensorSource("top", "/points", "velodyne", "", "rig file")
    camera = SensorSource("cam", "/image", "cam", "rig file", "rig file", -35.5)
    assert "time offset" not in text(sensors_table([lidar]))[1]
    _, header, *rows = text(sensors_table([lidar, camera]))
    assert header.endswith("time offset")
    assert [row.endswith("-35.5 ms") for row in rows] == [False, True]


def test_missing_sensors() -> None:
    """A camera and its boxes are one row if they agree."""
    silent = MissingSensor("cam11", "/image_11", 20, 30, (SilentSpan(1.0, None, 20),))
    names = {"a": 7, "b": 7, "a (boxes)": 7, "b (boxes)": 9, "c (boxes)": 7}
    slow = [MissingSensor(name, f"/{name}", frames, 30, ()) for name, frames in names.items()]
    assert text(missing_table([silent, *slow])) == [
        "missing from frames",
        "sensor           frames  when",
        "cam11                20  silent from 1.0 s to the end",
        "a and its boxes       7  in 7 of 30 frames",
        "b                     7  in 7 of 30 frames",
        "b (boxes)             9  in 9 of 30 frames",
        "c (boxes)             7  in 7 of 30 frames",
    ]


@pytest.mark.parametrize(
    ("value", "plain", "with_sign", "in_percent"),
    [
        (None, "-", "-", "-"),
        (0.0, "0.00", "+0.00", "0 %"),
        (-0.001, "0.00", "+0.00", "0 %"),
        (-0.006, "-0.01", "-0.01", "-1 %"),
        (1.234, "1.23", "+1.23", "123 %"),
    ],
)
def test_zero_has_no_minus_and_what_is_not_defined_is_a_dash(
    value: float | None, plain: str, with_sign: str, in_percent: str
) -> None:
    assert (number(value, 2), share(value), signed(value, 2)) == (plain, plain, with_sign)
    assert percent(value) == in_percent
