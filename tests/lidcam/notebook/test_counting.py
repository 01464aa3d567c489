"""Road users that cross lines: once each, by direction."""

from typing import Any

import numpy as np
import pytest

from lidcam.notebook.counting import count_lines
from lidcam.pipeline.core.errors import ConfigError
from lidcam.writers.tables.objects import Objects

EAST = {"east": ((10.0, 0.0), (10.0, 20.0))}
"""Who looks along it looks along +y: left is where x is smaller."""


def crossed(*ways: list[tuple[float, float]], lines: Any = EAST, class_ids: Any = None) -> list[tuple[int, int]]:
    """What is counted of tracks with these places, frame by frame."""
    rows = [
        (frame, track, (class_ids or {}).get(track, 0), *place)
        for track, way in enumerate(ways, 1)
        for frame, place in enumerate(way)
    ]
    rows.sort(key=lambda row: row[0])
    frames, tracks, classes, x, y = (np.array(column) for column in zip(*rows, strict=True))
    objects = Objects.zeros(len(rows), frame_id="site", class_names=("car", "bus"), zone_names=("",))
    values = {"frames": frames, "tracks": tracks, "class_ids": classes.astype(np.int32)}
    for name, value in values.items():
        object.__setattr__(objects, name, value)
    return [(one.to_left, one.to_right) for one in count_lines(objects, np.column_stack([x, y]), lines)]


def test_each_direction_is_counted() -> None:
    there, back = [(5.0, 5.0), (15.0, 5.0)], [(15.0, 6.0), (9.0, 6.0)]
    assert crossed(there, back, back) == [(2, 1)]
    assert crossed(there, back, class_ids={2: 1}) == [(0, 1), (1, 0)]


@pytest.mark.parametrize(
    "way",
    [
        [(5.0, 5.0), (9.9, 5.0)],  # not there yet
        [(5.0, -5.0), (15.0, -1.0)],  # past its end
        [(5.0, 25.0), (15.0, 21.0)],  # past its other end
        [(5.0, 5.0), (15.0, 5.0), (5.0, 5.0)],  # to and fro
        [(np.nan, 5.0), (15.0, 5.0)],  # nobody knows where
    ],
)
def test_what_is_not_counted(way: list[tuple[float, float]]) -> None:
    assert crossed(way) == []


def test_a_road_user_that_stands_on_the_line_is_counted_once() -> None:
    assert crossed([(5.0, 5.0), (10.0, 5.0), (9.9, 5.0), (10.1, 5.0), (10.0, 5.0), (15.0, 5.0)]) == [(0, 1)]


def test_tracks_do_not_join() -> None:
    assert crossed([(5.0, 5.0), (5.0, 6.0)], [(15.0, 5.0), (15.0, 6.0)]) == []


def test_lines_that_are_none() -> None:
    for ends in (((0, 0), (0, 0)), ((0, 0, 0), (1, 1, 1)), ((0, 0), (np.nan, 1))):
        with pytest.raises(ConfigError, match="lines: a: expected two different ends"):
            crossed([(0.0, 0.0)], lines={"a": ends})
    unnamed: Any = [((0, 0), (0, 1))]
    with pytest.raises(ConfigError, match="lines: expected lines by name, "):
        crossed([(0.0, 0.0)], lines=unnamed)


def test_nothing_crosses_where_nothing_is() -> None:
    nothing = Objects.zeros(frame_id="", class_names=("car",), zone_names=("",))
    assert count_lines(nothing, np.zeros((0, 2)), EAST) == ()
