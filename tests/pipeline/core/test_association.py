import numpy as np
import pytest

from pipeline.core.association import worth_of_pairs
from pipeline.core.settings.fuse import AssociateConfig


@pytest.mark.parametrize(
    ("iou", "differs", "expected"),
    [
        (0.5, False, 0.5),
        (0.5, True, 0.4),
        (0.3, False, 0.3),
        (0.29, False, 0.0),
        (0.0, True, 0.0),
    ],
)
def test_worth_is_the_overlap_less_a_penalty(iou: float, differs: bool, expected: float) -> None:
    config = AssociateConfig(min_iou=0.3, class_penalty=0.1)
    assert worth_of_pairs(np.array([[iou]]), np.array([[differs]]), config).tolist() == [[pytest.approx(expected)]]


def test_a_penalty_of_one_forbids_other_classes() -> None:
    config = AssociateConfig(min_iou=0.0, class_penalty=1.0)
    assert worth_of_pairs(np.array([1.0, 0.7, 0.0]), np.array([True, False, False]), config).tolist() == [0, 0.7, 0]
