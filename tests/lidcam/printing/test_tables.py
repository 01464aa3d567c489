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
        "objects, sum over 4 frames",
        "class  north  south  outside  all  a frame",
        "bus        0      3        0    3      0.8",
        "car        6      0        1    7      1.8",
    ]


@pytest.mark.parametrize(("frames", "heading"), [(1, "1 frame"), (20, "20 frames"), (0, "0 frames")])
def test_without_zones_there_are_no_columns_of_them(frames: int, heading: str) -> None:
    found = text(objects_table({("car", ""): 3}, [], frames))
    assert found[0] == f"objects, sum over {heading}"
    assert found[1].split() == ["class", "all", "a", "frame"]
    assert found[2].split()[:2] == ["car", "3"]


def test_no_objects() -> None:
    assert text(objects_table({}, [], 5))[2].split() == ["none", "0", "0.0"]
    assert text(objects_table({}, ["a"], 5))[2].split() == ["none", "0", "0", "0", "0.0"]
