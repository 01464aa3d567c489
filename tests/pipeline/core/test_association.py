import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_t

from lidcam.pipeline.core.association import (
    FREEDOM,
    PIXEL_SIGMA_PX,
    UNSEEN_BOXES,
    class_agreement,
    class_confusion,
    detector_variances,
    fit_ratios,
    rectangle_features,
    squared_distances,
)
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES

CAR, PEDESTRIAN, BICYCLE, TRUCK, BUS = range(5)


def test_features_of_rectangles() -> None:
    found = rectangle_features(np.array([[10, 20, 40, 30], [5, 5, 5.5, 5]], np.float32))
    np.testing.assert_allclose(found, [[25, 25, np.log(30), np.log(10)], [5.25, 5, 0, 0]], atol=1e-6)
    assert rectangle_features(np.zeros((0, 4), np.float32)).shape == (0, 4)


def test_variances_are_those_of_edges_that_err_independently(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.pipeline.core.association.OUTLINE_SIGMA", 0.05)
    rectangle = np.array([[100.0, 50, 500, 350]])
    random = np.random.default_rng(0)
    sigma = np.sqrt(PIXEL_SIGMA_PX**2 + (0.05 * np.array([400.0, 300])) ** 2)
    edges = rectangle + random.normal(0, 1, (200_000, 4)) * np.tile(sigma, 2)
    expected = rectangle_features(edges.astype(np.float32)).var(0)
    found = detector_variances(rectangle.astype(np.float32))[0]
    np.testing.assert_allclose(found, expected, rtol=0.03)


@given(st.lists(st.floats(-40, 40), min_size=4, max_size=4), st.lists(st.floats(0.01, 50), min_size=4, max_size=4))
def test_the_ratio_is_that_of_two_densities(differences: list[float], variances: list[float]) -> None:
    d, v = np.array([differences]), np.array([variances])
    found = fit_ratios(squared_distances(d, v), v, np.array([640.0 * 480]))
    same = multivariate_t(np.zeros(4), np.diag(v[0]), df=int(FREEDOM)).logpdf(d[0])
    other = np.log(UNSEEN_BOXES / (640 * 480 * 4 * 4))
    assert found == pytest.approx([same - other], abs=1e-9)


def test_what_has_nearly_the_same_size_is_nearly_the_same_class() -> None:
    confusion = class_confusion(ROAD_CLASSES)
    np.testing.assert_allclose(confusion.sum(1), 1)
    assert (confusion.argmax(1) == np.arange(5)).all()
    assert confusion[TRUCK, BUS] > confusion[CAR, TRUCK] > confusion[CAR, PEDESTRIAN]
    assert confusion[PEDESTRIAN, BICYCLE] > confusion[PEDESTRIAN, CAR]


def test_a_box_of_a_class_that_is_hardly_alike_says_little_but_of_a_rider() -> None:
    found = class_agreement(ROAD_CLASSES)
    assert (found.diagonal() == 0).all()
    assert 0 > found[TRUCK, BUS] > found[CAR, TRUCK] > found[CAR, PEDESTRIAN]
    told = class_agreement(ROAD_CLASSES, frozenset({(BICYCLE, PEDESTRIAN)}))
    assert (told[BICYCLE, PEDESTRIAN], told[PEDESTRIAN, BICYCLE]) == (0, found[PEDESTRIAN, BICYCLE])
