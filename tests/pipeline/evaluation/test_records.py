from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.detections import Boxes3D
from pipeline.evaluation.records import UNKNOWN, SourceBoxes, TruthBoxes2D, TruthBoxes3D


def truth(count: int) -> TruthBoxes3D:
    return TruthBoxes3D(
        stamp_ns=5,
        frame_id="site",
        centers=np.arange(3.0 * count).reshape(count, 3),
        sizes=np.ones((count, 3)),
        yaws=np.zeros(count),
        class_ids=np.zeros(count, np.int32),
        labels=np.array([f"label {row}" for row in range(count)], np.str_),
        track_ids=np.arange(count, dtype=np.int64),
        lidar_points=np.full(count, UNKNOWN, np.int32),
        image_pixels=np.full(count, UNKNOWN, np.int32),
        is_ignored=np.zeros(count, np.bool_),
    )


def truth2d(count: int) -> TruthBoxes2D:
    return TruthBoxes2D(
        stamp_ns=5,
        xyxy=np.zeros((count, 4), np.float32),
        class_ids=np.zeros(count, np.int32),
        labels=np.array(["car"] * count, np.str_),
        track_ids=np.arange(count, dtype=np.int64),
        image_pixels=np.zeros(count, np.int32),
        is_ignored=np.zeros(count, np.bool_),
    )


@pytest.mark.parametrize("count", [0, 1, 3])
def test_rows_stay_together(count: int) -> None:
    rows = np.arange(count)[::-1]
    assert truth(count).select(rows).labels.tolist() == [f"label {row}" for row in rows]
    assert truth(count).select(rows).track_ids.tolist() == rows.tolist()
    assert truth2d(count).select(rows).track_ids.tolist() == rows.tolist()
    assert len(truth(count)) == len(truth2d(count)) == count


def test_arrays_of_other_lengths_or_types_are_refused() -> None:
    with pytest.raises(ValueError, match="labels"):
        replace(truth(2), labels=np.array(["car"]))
    with pytest.raises(ValueError, match="labels"):
        replace(truth(2), labels=np.array([1, 2]))
    with pytest.raises(ValueError, match="track_ids"):
        replace(truth2d(2), track_ids=np.zeros(3, np.int64))


def test_ids_belong_to_their_boxes() -> None:
    boxes = Boxes3D(
        5,
        "site",
        np.arange(6.0).reshape(2, 3),
        np.ones((2, 3)),
        np.zeros(2),
        np.ones(2, np.float32),
        np.zeros(2, np.int32),
        np.zeros(2, np.int32),
        np.zeros((2, 3, 3)),
        np.zeros(2, np.uint8),
        np.zeros(2, np.int64),
    )
    source = SourceBoxes(boxes, np.array([7, 9], np.int64))
    chosen = source.select(np.array([1]))
    assert len(source) == 2
    assert (chosen.track_ids.tolist(), chosen.boxes.centers.tolist()) == ([9], [[3.0, 4.0, 5.0]])
    with pytest.raises(ValueError, match="track_ids"):
        SourceBoxes(boxes, np.zeros(1, np.int64))
