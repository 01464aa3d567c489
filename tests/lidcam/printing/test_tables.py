from io import StringIO

import pytest
from rich.console import Console, RenderableType

from lidcam.printing.tables import objects_table

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
