"""What a page is made of stays bounded, however long the recording is, and loses no count."""

import numpy as np
import pytest

from lidcam.writers.report import collector
from lidcam.writers.report.collector import MAX_STEPS, Courses, Timeline
from lidcam.writers.report.grid import SparseGrid


def test_a_grid_of_nothing_and_of_one() -> None:
    grid = SparseGrid(0.5, 10)
    grid.add_points(np.zeros((0, 2)))
    assert len(grid) == 0
    grid.add_points(np.array([[-0.1, 3.3], [-0.2, 3.4]]))
    np.testing.assert_allclose(grid.centers, [[-0.25, 3.25]])
    assert grid.counts.tolist() == [1]  # a frame counts a cell once


def test_cells_become_larger_and_keep_their_counts() -> None:
    chance, grid, count = np.random.default_rng(0), SparseGrid(0.1, 64), 0
    for _ in range(20):
        points = chance.uniform(-5, 5, (30, 2))
        count += len(np.unique(np.floor(points / grid.cell_m), axis=0))
        grid.add_points(points)
        assert len(grid) <= 64
    assert grid.cell_m > 0.1
    assert grid.counts.sum() == count  # of the cells as they were
    assert (np.abs(grid.centers) < 5 + grid.cell_m).all()


def test_steps_of_time_double_and_keep_their_sums() -> None:
    time = Timeline()
    stamps_s = np.arange(20_000) * 0.1
    for stamp_s in stamps_s.tolist():
        time.add_frame(stamp_s, {"car": 2.0}, stamp_s)
    assert (time.step_s, len(time.counts())) == (6.4, 313)
    assert len(time.counts()) <= MAX_STEPS
    assert (time.sums("car").sum(), time.counts().sum()) == (40_000, 20_000)
    assert time.largest()[-1] == stamps_s[-1]
    assert (np.diff(time.largest()) > 0).all()
    assert not time.sums("nobody").any()
    time.add_frame(-5.0, {"car": 1.0})  # where time goes back
    assert time.sums("car")[0] == 2 * 64 + 1


def test_long_steps_are_kept_when_time_jumps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collector, "MAX_STEPS", 8)
    time = Timeline()
    for stamp_s in (0.0, 100.0):
        time.add_frame(stamp_s, {"car": 1.0})
    assert time.counts().tolist() == [1, 0, 0, 0, 0, 0, 0, 1]


def test_the_last_step_ends_with_the_frames() -> None:
    time = Timeline()
    for stamp_s in (0.0, 10.0):
        time.add_frame(stamp_s, {})
    time.at_least(15.0)
    assert time.edges_s.tolist() == pytest.approx([0.0, 10.1])


def test_a_way_is_drawn_by_its_corners() -> None:
    ways = Courses()
    for step in range(100):
        ways.add_frame(0.1 * step, np.array([3, 9]), np.array([[0.1 * step, 0.0], [5.0, 5.0]]), np.array([1.0, 0.0]))
    (moving, line), (standing, place) = ways.lines()
    assert (moving, standing, len(place)) == (3, 9, 2)
    np.testing.assert_allclose(line[[0, -1]], np.array([[0, 0, 1, 0], [9.9, 0, 1, 9.9]]))


def test_ways_are_simplified_and_the_shortest_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collector, "MAX_POINTS", 200)
    ways = Courses()
    for step in range(500):
        ways.add_frame(0.1 * step, np.array([1]), np.array([[0.05 * step, 0.0]]), np.ones(1))
    ((_, line),) = ways.lines()
    assert 20 < len(line) <= 200
    assert ways.tolerance_m > 0.05
    np.testing.assert_allclose(line[-1, :2], [24.95, 0.0])
    for number in range(2, 400):  # many that stand
        ways.add_frame(60.0, np.array([number]), np.array([[number, 1.0]]), np.zeros(1))
    drawn = [number for number, _ in ways.lines()]
    assert drawn[0] == 1
    assert len(drawn) + ways.left_out == 399
    assert sum(len(line) for _, line in ways.lines()) <= 200
