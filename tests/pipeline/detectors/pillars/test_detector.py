"""3D networks in pillars: what they are given, what is made of their output, and files that are none."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from detections import boxes3d
from lidar_scene import Box, combined, rig, scan, turned
from pillar_files import GRID, boxes_found, numbers_of, write_pillars

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.pillars.detector import by_points, merged
from lidcam.pipeline.detectors.pillars.grid import FEATURES, pillars
from lidcam.pipeline.stages.detect3d import Detect3D

CAR: Box = (8.2, -3.1, 0.8, 4.2, 1.75, 1.5, 2.5)
PERSON: Box = (5.0, 6.0, 0.9, 0.6, 0.6, 1.75, 0.0)
EMPTY: Box = (-9.0, -9.0, 0.8, 4.2, 1.75, 1.5, 0.0)
CLASSES: list[dict[str, Any]] = [{"name": "Pedestrian"}, {"name": "car", "sigma_m": 0.2, "sigma_rad": 0.1}]
LIDAR = (0.0, 0.0, 1.8)
MODEL_CAR = "classes=[{name: car, size_m: [0.33, 0.22, 0.21], max_size_m: [0.42, 0.28, 0.26]}]"


def write(path: Path, **said: object) -> Path:
    """A network that finds the car, the person less surely, something of which no point is seen, and a doubtful car."""
    boxes = np.array([CAR, PERSON, EMPTY, (5.0, 9.0, *PERSON[2:])])
    odds = np.array([2.0, 1.0, 3.0, -3.0])
    numbers = numbers_of(boxes[:, :3], boxes[:, 3:6], boxes[:, 6], odds, [1, 0, 1, 1], 2)
    return write_pillars(path, numbers, CLASSES, **said)


def config(path: Path | None, *more: str) -> Any:
    return load_config("road", (*(() if path is None else (f"detect3d.model={path}",)), *more))


@pytest.mark.parametrize("lidar_xy", [(0.0, 0.0), (100.0, -40.0)])
def test_boxes_stand_where_the_network_finds_them(tmp_path: Path, lidar_xy: tuple[float, float]) -> None:
    points = turned(scan(LIDAR, [CAR, PERSON]), 0.0, lidar_xy)
    boxes = boxes_found(rig((*lidar_xy, LIDAR[2])), config(write(tmp_path / "net.onnx")), combined(points))
    assert boxes.class_ids.tolist() == [0, 1]
    np.testing.assert_allclose(boxes.centers - [*lidar_xy, 0], [CAR[:3], PERSON[:3]], atol=1e-5)
    np.testing.assert_allclose(boxes.sizes, [CAR[3:6], PERSON[3:6]], rtol=1e-5)
    np.testing.assert_allclose(boxes.yaws, [CAR[6], PERSON[6]], atol=1e-5)
    np.testing.assert_allclose(boxes.scores, 1 / (1 + np.exp([-2.0, -1.0])), rtol=1e-5)
    np.testing.assert_allclose(boxes.covariances[0], np.diag([0.04, 0.04, 0.01]))
    assert (boxes.point_counts > 20).all()
    assert not len(Detect3D(rig(LIDAR), config(tmp_path / "net.onnx"))(combined(np.zeros((0, 3)))))


@pytest.mark.parametrize(
    ("said", "settings", "message"),
    [
        ({"metadata": None}, (), r"net\.onnx: expected a 3D network .*, found none of its metadata"),
        ({"classes": []}, (), "found metadata with a fault: classes"),
        ({"classes": [{"name": "car", "sigma_rad": 0}]}, (), r"found metadata with a fault: classes\.0\.sigma_rad"),
        ({"grid": {**GRID.model_dump(), "cell_m": -1}}, (), r"found metadata with a fault: grid\.cell_m"),
        ({"grid": {**GRID.model_dump(), "cells": 63}}, (), "found other features or another grid: train it anew"),
        ({"features": ["x"]}, (), "found other features or another grid: train it anew"),
        ({"classes": [{"name": "tram"}, {"name": "dog"}]}, (), "finds tram, dog; expected one that is a class"),
        ({"classes": [{"name": "car"}]}, (), r"numbers \(1, 9, 32, 32\), found float32 \(1, 10, 32, 32\)"),
        ({}, (MODEL_CAR,), r"has pillars of 0\.5 m, expected narrower ones .* \(car 0\.22 m\)"),
        (None, ("detect3d.method=pillars",), "give --model-3d FILE.onnx or set detect3d.model"),
    ],
)
def test_what_a_file_lacks(
    tmp_path: Path, said: dict[str, object] | None, settings: tuple[str, ...], message: str
) -> None:
    path = None if said is None else write(tmp_path / "net.onnx", **said)
    with pytest.raises(ModelError, match=message):
        Detect3D(rig(LIDAR), config(path, *settings))(combined(scan(LIDAR, [CAR])))


def test_clusters_stay_where_they_are_asked_for(tmp_path: Path) -> None:
    """As with any other network that is named and not wanted."""
    settings = config(tmp_path / "none.onnx", "detect3d.method=cluster", "detect3d.score=geometric")
    assert len(Detect3D(rig(LIDAR), settings)(combined(scan(LIDAR, [CAR])))) == 1


def test_pillars_of_points() -> None:
    """Two points in one pillar, one in the next row, and three beyond the grid; in any order."""
    half = GRID.half_m
    points = np.array(
        [[0.1, 0.1, 1.0], [0.3, 0.1, 2.0], [0.1, 0.6, 1.0], [half, 0, 1.0], [0, 0, GRID.low_m - 0.01], [0, 0, 4.0]]
    )
    features, pillar = pillars(points, GRID)
    assert features.dtype == np.float32
    assert features.shape == (3, len(FEATURES))
    assert pillar.tolist() == [32 * 64 + 32, 32 * 64 + 32, 33 * 64 + 32]
    expected = [1.0, -0.2, 0.0, -0.5, -0.3, -0.3, np.log(2), np.hypot(0.1, 0.1) / half]
    np.testing.assert_allclose(features[0], expected, atol=2e-4)
    order = np.random.default_rng(0).permutation(len(points))
    again, places = pillars(points[order], GRID)
    rows = np.argsort(order[order < 3])
    np.testing.assert_array_equal(again[rows], features)
    np.testing.assert_array_equal(places[rows], pillar)


@pytest.mark.parametrize(
    ("turn", "is_fitted"),
    [(0.15, True), (0.7, True), (np.pi - 0.15, True), (1.4, False)],
    ids=["ahead", "far off", "reversed", "across"],
)
def test_boxes_are_fitted_to_their_points(tmp_path: Path, turn: float, is_fitted: bool) -> None:
    """A box that lies across its points stays where the network has it."""
    said = np.add(CAR, (0.15, -0.1, 0, -0.2, 0.1, 0.1, turn))[None]
    numbers = numbers_of(said[:, :3], said[:, 3:6], said[:, 6], np.array([2.0]), [0], 1)
    model = write_pillars(tmp_path / "net.onnx", numbers, [{"name": "car"}])
    config = load_config("road", (f"detect3d.model={model}", "detect3d.method=pillars"))
    boxes = Detect3D(rig(LIDAR), config)(combined(scan(LIDAR, [CAR])))
    expected = np.add(CAR, np.eye(7)[6] * round(turn / np.pi) * np.pi) if is_fitted else said[0]
    np.testing.assert_allclose(boxes.centers[0, :2], expected[:2], atol=0.12 if is_fitted else 1e-5)
    off = np.angle(np.exp(1j * (boxes.yaws[0] - expected[6])))
    assert abs(off) < (0.03 if is_fitted else 1e-5)


def test_the_more_points_the_better_place_and_heading_are_known() -> None:
    boxes = boxes3d([[8, -3, 0.8, 4.0, 1.7, 1.5, 0.2]] * 4, deviations=(0.3, 0.2, 0.1))
    counts = np.array([5, 31, 250, 4000], np.int32)
    sigmas = np.sqrt(np.diagonal(by_points(replace(boxes, point_counts=counts)), axis1=1, axis2=2))
    np.testing.assert_allclose(sigmas[:, 0], [0.684, 0.301, 0.164, 0.136], atol=1e-3)
    np.testing.assert_allclose(sigmas[:, 1], sigmas[:, 0] * 2 / 3)
    np.testing.assert_allclose(sigmas[:, 2], [0.247, 0.103, 0.047, 0.033], atol=1e-3)


def test_a_merged_box_lies_nearer_to_the_more_exact_one() -> None:
    exact = boxes3d([8, -3, 0.8, 4.0, 1.7, 1.5, 0.2], deviations=(0.1, 0.1, 0.1))
    rough = boxes3d([8.5, -3, 0.9, 4.4, 1.9, 1.7, 0.7 - np.pi], deviations=(0.2, 0.1, 0.2))
    both = merged(rough, exact, np.array([[0.75, 0.5, 0.25]]))
    np.testing.assert_allclose(both.centers, [[8.1, -3, 0.825]])
    np.testing.assert_allclose(both.sizes, [[4.3, 1.8, 1.55]])
    np.testing.assert_allclose(both.yaws, [0.3])
    np.testing.assert_allclose(both.covariances, np.diag([0.012, 0.0075, 0.012])[None], atol=1e-12)
    # Of two equal ones, of which half of the error is the same.
    np.testing.assert_allclose(merged(exact, exact, np.ones((1, 3))).covariances, 0.75 * exact.covariances)
