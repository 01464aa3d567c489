import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.tracking.motion import (
    Motions,
    Priors,
    at_centers,
    at_rear_axles,
    expected,
    innovations,
    predicted,
    updated,
)

PRIORS = Priors.of_classes(ROAD_CLASSES)
STATES = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3), st.floats(-20, 20), st.floats(-1, 1)).map(
    lambda state: np.array([state])
)
SECONDS = st.floats(-0.5, 0.5)


def motions(states: np.ndarray) -> Motions:
    return Motions(states, np.tile(np.diag([0.1, 0.2, 0.05, 1.0, 0.1]), (len(states), 1, 1)))


@given(state=STATES, seconds=SECONDS)
def test_derivatives_are_those_of_differences(state: np.ndarray, seconds: float) -> None:
    after_s, rear_m, no_noise, step = np.array([seconds]), np.array([1.1]), np.zeros((1, 5)), 1e-6
    beside = [motions(state + sign * step * axis) for sign in (1, -1) for axis in np.eye(5)]
    moved = np.array([predicted(one, after_s, no_noise)[0].states[0] for one in beside]).reshape(2, 5, 5)
    boxes = np.array([expected(one, after_s, rear_m)[0][0] for one in beside]).reshape(2, 5, 3)
    slopes = predicted(motions(state), after_s, no_noise)[1][0], expected(motions(state), after_s, rear_m)[1][0]
    for ends, of_state in zip((moved, boxes), slopes, strict=True):
        np.testing.assert_allclose(of_state, (ends[0] - ends[1]).T / (2 * step), atol=1e-4)


@given(state=STATES, seconds=SECONDS, class_id=st.integers(0, 4))
def test_a_step_back_in_time_is_one_ahead_of_what_drives_backwards(
    state: np.ndarray, seconds: float, class_id: int
) -> None:
    after_s, noise, backwards = np.array([seconds]), PRIORS.noise[[class_id]], np.array([1, 1, 1, -1, -1])

    def reversed_in_time(one: Motions) -> Motions:
        return Motions(one.states * backwards, one.covariances * np.outer(backwards, backwards))

    there = predicted(motions(state), after_s, noise)[0]
    again = reversed_in_time(predicted(reversed_in_time(motions(state)), -after_s, noise)[0])
    np.testing.assert_allclose(again.states, there.states, atol=1e-9)
    np.testing.assert_allclose(again.covariances, there.covariances, atol=1e-9)


@given(state=STATES, rear_m=st.floats(-3, 3))
def test_places_go_to_the_rear_axle_and_back(state: np.ndarray, rear_m: float) -> None:
    there = at_rear_axles(motions(state), np.array([rear_m]))
    back = at_centers(there, np.array([rear_m]))
    np.testing.assert_allclose(back.states, state, atol=1e-9)
    np.testing.assert_allclose(back.covariances, motions(state).covariances, atol=1e-9)


def test_yaws_count_modulo_half_a_turn() -> None:
    difference, _ = innovations(motions(np.zeros((1, 5))), np.array([[0.0, 0.0, 3.1]]), np.zeros(1), np.zeros(1))
    assert difference[0, 2] == pytest.approx(3.1 - np.pi)
    assert wrap_angle(np.array([np.pi, -np.pi, 4.0])) == pytest.approx([np.pi, np.pi, 4.0 - 2 * np.pi])


def test_a_measurement_beside_the_others_counts_less() -> None:
    before, row = motions(np.zeros((1, 5))), np.eye(5)[None, :2]
    noise, far = np.tile(np.eye(2) * 0.1, (1, 1, 1)), np.array([[10.0, 0.0]])
    plain, robust = updated(before, far, row, noise), updated(before, far, row, noise, 9.0)
    assert 0 < robust.states[0, 0] < plain.states[0, 0]
    assert (
        updated(before, far / 100, row, noise, 9.0).states[0, 0] == updated(before, far / 100, row, noise).states[0, 0]
    )


def test_priors_of_a_model_are_those_of_the_car_in_its_scale() -> None:
    small = [prior.model_copy(update={"size_m": tuple(side / 14 for side in prior.size_m)}) for prior in ROAD_CLASSES]
    of_small = Priors.of_classes(small)
    np.testing.assert_allclose(of_small.speeds[0], PRIORS.speeds[0] / 14)
    np.testing.assert_allclose(of_small.noise[0, [0, 2]], PRIORS.noise[0, [0, 2]] / 14**2)
    assert of_small.show_axis.tolist() == PRIORS.show_axis.tolist() == [True, False, True, True, True]
    assert PRIORS.are_solid.tolist() == [True, False, False, True, True]
