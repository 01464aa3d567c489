"""What the plots of a page show where there is little: one frame, a silent sensor, nothing found."""

from dataclasses import replace

import numpy as np
import pytest
from evaluation_frames import frame_of, rows_at, source_boxes, truth_boxes
from frames import CONFIG, RIG

from lidcam.pipeline.evaluation.detection.plots import DetectionPlots
from lidcam.pipeline.evaluation.evaluation_frame import FrameSync, Motion, SourceBoxes
from lidcam.writers.report import collector
from lidcam.writers.report.accuracy import error_map
from lidcam.writers.report.collector import MAX_STEPS, Courses, ReportCollector, Timeline
from lidcam.writers.report.grid import SparseGrid
from lidcam.writers.report.plots import objects_figure, sensors_figure, skew_figure
from lidcam.writers.report.site_map import map_figure

NAMES = CONFIG.class_names


def seen_once() -> ReportCollector:
    """One frame of one car, whose speed nobody knows; the first sensor has a message, the second is missing."""
    unknown = Motion(np.full((1, 2), np.nan), np.full(1, np.nan), *np.zeros((2, 1), np.bool_))
    car = SourceBoxes(source_boxes(rows_at([(1.0, 2.0)])).boxes, np.array([4]), unknown)
    seen = ReportCollector(CONFIG, RIG)
    (topic, _), (_, missing), *_ = RIG.sensor_of_topic.items()
    sync = FrameSync(10, {topic: 0}, {missing: "silent"})
    seen.add_frame(replace(frame_of(0, None, {"fused": car}), sync=sync, skew_ns=3_000_000))
    return seen


def test_an_object_without_known_speed_is_on_the_map() -> None:
    figure = map_figure(seen_once(), RIG, None, NAMES)
    dots = [trace for trace in figure["data"] if trace["mode"] == "markers"]
    assert [(trace["x"], trace["y"]) for trace in dots] == [([1.0], [2.0])]
    assert figure["views"] == []  # none by speed


def test_one_frame_is_a_step() -> None:
    seen = seen_once()
    for figure, value in ((objects_figure(seen, NAMES, RIG.place_names), 1.0), (skew_figure(seen), 3.0)):
        trace = figure["data"][0]
        assert (trace["x"], trace["y"]) == ([0.0, 0.1], [value, value])


def test_a_sensor_that_never_came_is_red() -> None:
    (trace,) = sensors_figure(seen_once(), RIG)["data"]
    assert (trace["x"], trace["y"]) == ([0.0, 0.1], [*RIG.sensor_of_topic.values()][1::-1])  # others are not used
    assert trace["z"] == [[0.0], [1.0]]


def test_a_slow_sensor_is_shown_where_it_came() -> None:
    first, *_ = RIG.sensor_of_topic
    seen = ReportCollector(CONFIG, RIG)
    for index in range(13):  # 10 Hz, the sensor at 5 Hz
        sync = FrameSync(index, {first: 0} if index % 2 == 0 else {}, {})
        seen.add_frame(replace(frame_of(index, None, {}), sync=sync))
    seen.sensors.at_least(0.2)
    (trace,) = sensors_figure(seen, RIG)["data"]
    assert trace["z"][-1] == [1.0] * 7


def test_errors_of_what_nobody_found_are_not_drawn() -> None:
    for found, views in (([], ["share missed"]), ([(1.0, 2.0)], ["position error", "share missed"])):
        plots = DetectionPlots(CONFIG)
        truth = truth_boxes(rows_at([(1.0, 2.0)]))
        plots.add_frame(frame_of(0, truth, {"fused": source_boxes(rows_at(found))}))
        figure = error_map(plots)
        assert figure is not None
        assert figure["views"] == [trace["meta"] for trace in figure["data"]] == views
        assert all(len(trace["x"]) == len(trace["z"][0]) + 1 for trace in figure["data"])


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
