import numpy as np
import pytest
from detections import boxes2d
from pipeline.fusion.cameras.observed import Noise, Observed, observe
from seen_boxes import camera_at, views_of

from pipeline.fusion.cameras.sightings import see

LEVEL = camera_at("level", (0.0, 0.0, 1.6))
NOISE = Noise(2.0, 0.0, 0.05, 0.01, 0.002)


def observed(*rows: tuple[float, ...], noise: Noise = NOISE) -> Observed:
    return observe(see(views_of(LEVEL), {"level": boxes2d(rows)}), noise)


def test_directions_of_the_edges() -> None:
    found = observed((640, 360, 1090, 450, 0.9, 0))  # 450 px to the right of the middle, 90 px below it; f = 900
    assert found.left == pytest.approx([0.0])
    assert found.width == pytest.approx([np.arctan(0.5)])
    assert found.middle == pytest.approx([-np.arctan(0.5) / 2])
    assert found.upper == pytest.approx([0.0])
    assert found.lower == pytest.approx([-0.1 / np.hypot(1, 0.25)])


def test_errors_are_those_of_pixels_and_of_the_box() -> None:
    found = observed((600, 300, 700, 500, 0.9, 0))
    assert found.stds[0, 0] == pytest.approx(2 / 100 * found.width[0])
    assert found.stds[0, 1] == found.stds[0, 3] == pytest.approx(2 / 200 * (found.upper - found.lower)[0])
    both = observed((600, 300, 700, 500, 0.9, 0), noise=Noise(2.0, 0.05, 0.05, 0.01, 0.002))
    assert both.stds[0, 0] == pytest.approx(np.hypot(2, 0.05 * np.sqrt(100 * 200)) / 100 * found.width[0])


def test_nothing_is_known_of_a_cut_edge() -> None:
    found = observed((0, 300, 100, 720, 0.9, 0))
    assert (found.stds[0, [0, 3]] > 5 * np.array([found.width[0], found.upper[0] - found.lower[0]])).all()
    assert (found.stds[0, [1, 2]] < 0.1 * np.array([found.upper[0] - found.lower[0], found.width[0]])).all()


@pytest.mark.parametrize(
    ("front", "hidden"),
    [
        ((520, 460, 800, 600), [False, False, False, True]),  # below, over the whole width
        ((450, 320, 600, 600), [True, False, False, True]),
        ((650, 320, 900, 600), [False, False, True, True]),
        ((100, 320, 300, 600), [False] * 4),  # elsewhere
        ((520, 200, 800, 380), [False] * 4),  # further away
        ((450, 320, 580, 501), [False] * 4),  # as near
    ],
)
def test_edges_that_a_nearer_object_may_hide(front: tuple[float, ...], hidden: list[bool]) -> None:
    alone = observed((550, 300, 700, 500, 0.5, 0))
    found = observed((*front, 0.9, 0), (550, 300, 700, 500, 0.5, 0))
    assert (found.stds[1] > 3 * alone.stds[0]).tolist() == hidden
    if any(hidden):
        np.testing.assert_allclose(found.stds[0], observed((*front, 0.9, 0)).stds[0])


def test_nothing() -> None:
    assert observed().stds.shape == (0, 4)
