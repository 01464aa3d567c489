"""What the plots of a page show where there is little: one frame, a silent sensor, nothing found."""

from dataclasses import replace

import numpy as np
from evaluation_frames import frame_of, rows_at, source_boxes, truth_boxes
from frames import CONFIG, RIG

from lidcam.pipeline.evaluation.detection.plots import DetectionPlots
from lidcam.pipeline.evaluation.evaluation_frame import FrameSync, Motion, SourceBoxes
from lidcam.writers.report.accuracy import error_map
from lidcam.writers.report.collector import ReportCollector
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
