import numpy as np
import pytest
from detections import boxes3d
from pipeline.fusion.overlaps import first_of_each, overlap_shares


def test_share_is_that_of_the_smaller_box() -> None:
    big, small = (0, 0, 0, 10, 10, 1, 0), (4.5, 0, 0, 2, 1, 1, 0)
    shares = overlap_shares(boxes3d([big, (50, 0, 0, 1, 1, 1, 0)]), boxes3d([small, big]))
    assert shares == pytest.approx(np.array([[0.75, 1.0], [0.0, 0.0]]))


def test_each_box_gives_way_to_a_kept_one_before_it() -> None:
    # the second gives way to the first, so the third, which overlaps the second alone, stays
    row = boxes3d([(0, 0, 0, 2, 1, 1, 0), (1, 0, 0, 2, 1, 1, 0), (2, 0, 0, 2, 1, 1, 0)])
    assert first_of_each(row, 0.25).tolist() == [True, False, True]
    assert first_of_each(row, 0.6).tolist() == [True, True, True]


def test_nothing() -> None:
    none = boxes3d([])
    assert overlap_shares(none, boxes3d([(0, 0, 0, 1, 1, 1, 0)])).shape == (0, 1)
    assert len(first_of_each(none, 0.5)) == 0
