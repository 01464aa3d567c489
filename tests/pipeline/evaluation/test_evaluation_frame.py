from dataclasses import replace

import numpy as np
import pytest
from evaluation_frames import rows_at, source_boxes, truth_boxes
from evaluation_scenes import truth2d

from pipeline.evaluation.evaluation_frame import SourceBoxes


@pytest.mark.parametrize("count", [0, 1, 3])
def test_rows_stay_together(count: int) -> None:
    rows, labels = np.arange(count)[::-1], [f"label {row}" for row in range(count)]
    truth = truth_boxes(rows_at([(row, 0) for row in range(count)]), range(count), labels=labels)
    images = replace(truth2d(np.zeros((count, 4)), [0] * count), track_ids=np.arange(count, dtype=np.int64))
    assert truth.select(rows).labels.tolist() == labels[::-1]
    assert truth.select(rows).centers[:, 0].tolist() == truth.select(rows).track_ids.tolist() == rows.tolist()
    assert images.select(rows).track_ids.tolist() == rows.tolist()
    assert len(truth) == len(images) == count


def test_arrays_of_other_lengths_or_types_are_refused() -> None:
    truth = truth_boxes(rows_at([(0, 0), (1, 0)]))
    for labels in (np.array(["car"]), np.array([1, 2])):
        with pytest.raises(ValueError, match="labels"):
            replace(truth, labels=labels)
    with pytest.raises(ValueError, match="track_ids"):
        replace(truth2d(np.zeros((2, 4)), [0, 0]), track_ids=np.zeros(3, np.int64))


def test_ids_belong_to_their_boxes() -> None:
    source = source_boxes(rows_at([(0, 0), (3, 4)]), [7, 9])
    chosen = source.select(np.array([1]))
    assert len(source) == 2
    assert (chosen.track_ids.tolist(), chosen.boxes.centers[0, :2].tolist()) == ([9], [3, 4])
    with pytest.raises(ValueError, match="track_ids"):
        SourceBoxes(source.boxes, np.zeros(1, np.int64))
