"""Frames and true objects are counted by what becomes of them."""

from evaluation_frames import frame_of, rows_at, truth_boxes

from lidcam.evaluation.counts import FrameCounts
from lidcam.pipeline.core.settings.config import Config


def test_every_object_is_counted_once_with_the_first_reason() -> None:
    counts = FrameCounts(Config.model_validate({"evaluate": {"max_range_m": 50}}))
    truth = truth_boxes(
        rows_at([(1, 0), (2, 0), (3, 0), (90, 0), (5, 0), (6, 0), (99, 0)]),
        class_ids=[0, -1, 0, 0, 0, 0, -1],
        labels=["car", "tram", "car", "car", "car", "car", "animal"],
        is_ignored=[False, True, True, False, False, False, False],
        lidar_points=[9, 9, 9, 9, 0, 0, 0],
        image_pixels=[0, 0, 9, 0, 0, 5, 0],
    )
    for index, found in enumerate([None, truth, truth, truth_boxes([])]):
        counts.add(frame_of(index, found))
    figures = counts.figures()
    assert (figures["frames"], figures["frames_with_truth"]) == (4, 3)
    assert figures["truth_objects"] == {
        "evaluated": 4,
        "without_class": 4,
        "marked_as_ignored": 2,
        "outside": 2,
        "unseen": 2,
        "labels_without_class": {"animal": 2, "tram": 2},
    }
