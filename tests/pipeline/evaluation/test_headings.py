"""Which turns are flips."""

import numpy as np
import pytest

from pipeline.evaluation.headings import is_flip


@pytest.mark.parametrize("sign", [-1, 1])
def test_more_than_a_right_angle_to_either_side(sign: int) -> None:
    turns_rad = sign * np.radians([0, 45, 89.9, 90, 90.1, 135, 180])
    assert is_flip(turns_rad).tolist() == [False] * 4 + [True] * 3


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_right_angle_is_none_whatever_rounding_makes_of_it(kind: type[np.floating]) -> None:
    right = np.array([np.pi / 2, -np.pi / 2], kind)
    turns_rad = np.concatenate([right, np.nextafter(right, np.sign(right) * kind(4))])
    assert (np.abs(turns_rad.astype(np.float64)) > np.pi / 2).any()
    assert not is_flip(turns_rad).any()


def test_no_turns() -> None:
    assert is_flip(np.zeros(0)).tolist() == []
