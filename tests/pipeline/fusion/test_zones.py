import numpy as np
import pytest
from detections import boxes3d
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.rig import Zone, ZoneUse
from lidcam.pipeline.fusion.zones import is_reported, select_by_zones


def square(name: str, x: float, y: float, side: float, use: ZoneUse = "count") -> Zone:
    corners = np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]], np.float64)
    return Zone(name, corners, use)


COUNTED, YARD = square("lane", -50, -50, 100), square("yard", 0, 0, 10, "ignore")
ROAD, PATH = square("road", -5, -5, 10, "detect"), square("path", 20, 20, 5, "detect")
PLACES = np.array([[-3.0, -3.0], [3, 3], [10, 10], [22, 22], [30, 30], [10.01, 3]])


def fused(places: np.ndarray) -> Fused:
    rows = [(x, y, 0.8, 4, 2, 1.5, 0.0) for x, y in places]
    boxes = boxes3d(rows)
    return Fused(boxes, np.arange(len(rows)).astype(np.int32), np.arange(len(rows)) + 5)


@pytest.mark.parametrize(
    ("zones", "reported"),
    [
        pytest.param([], [1, 1, 1, 1, 1, 1], id="no zones"),
        pytest.param([COUNTED], [1, 1, 1, 1, 1, 1], id="only counted"),
        pytest.param([COUNTED, YARD], [1, 0, 0, 1, 1, 1], id="ignored, the edge too, whatever comes first"),
        pytest.param([ROAD], [1, 1, 0, 0, 0, 0], id="one to detect in"),
        pytest.param([PATH, COUNTED, ROAD], [1, 1, 0, 1, 0, 0], id="two to detect in"),
        pytest.param([ROAD, YARD], [1, 0, 0, 0, 0, 0], id="ignoring is stronger"),
    ],
)
def test_which_objects_are_reported(zones: list[Zone], reported: list[int]) -> None:
    assert is_reported(PLACES, zones).astype(int).tolist() == reported
    found = select_by_zones(fused(PLACES), zones)
    rows = np.flatnonzero(reported)
    np.testing.assert_array_equal(found.objects.centers[:, :2], PLACES[rows])
    assert found.matched.tolist() == rows.tolist()
    assert found.rows.tolist() == (rows + 5).tolist()
    assert sum(found.left_out.values()) == len(PLACES) - len(rows)


def test_reasons() -> None:
    bin_, shed = square("bin", 29, 29, 3, "ignore"), square("shed", 2, 2, 2, "ignore")
    assert select_by_zones(fused(PLACES), [YARD, ROAD, shed, bin_]).left_out == {
        "outside of all zones of use detect": 2,
        "in zone yard of use ignore": 2,
        "in zone bin of use ignore": 1,
    }


points = st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), max_size=20)


@given(points)
def test_selecting_twice_is_selecting_once(places: list[tuple[float, float]]) -> None:
    zones = [YARD, ROAD, PATH]
    once = select_by_zones(fused(np.array(places).reshape(-1, 2)), zones)
    twice = select_by_zones(once, zones)
    assert twice.rows.tolist() == once.rows.tolist()
    assert sum(once.left_out.values()) + len(once.objects) == len(places)
