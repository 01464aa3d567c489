"""Networks of the kits: their features of points, and their boxes."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan, turned
from onnx_files import value, write_model
from pillar_files import boxes_found

from lidcam.pipeline.core.clouds import CombinedCloud, Plane
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.pillars.detector import PillarPoints
from lidcam.pipeline.detectors.pillars.kits import KEY, KitSpecs, kit_pillars

CAR: Box = (8.2, -3.1, 0.8, 4.2, 1.75, 1.5, 2.5)
LIDAR = (0.0, 0.0, 1.8)
SPECS: dict[str, Any] = {
    "classes": [{"name": "Pedestrian"}, {"name": "car"}],
    "features": ["x", "y", "z", "intensity", "dx_mean", "dy_mean", "dz_mean", "dx_cell", "dy_cell", "dz_cell"],
    "max_points": 2,
    "grid": {"low_m": [0, -8, -3], "high_z_m": 1, "cell_m": [0.5, 0.25], "cells": [32, 64]},
    "ground_z_m": -1.5,
    "intensity_max": 255,
}


def write(path: Path, boxes: list[list[float]], odds: list[list[float]], **said: object) -> Path:
    """A network that gives these rows of numbers, whatever its input."""
    held = {"boxes": np.array(boxes, np.float32), "log_odds": np.array(odds, np.float32)}
    inputs = [value("features", ("points", len(SPECS["features"]))), value("pillar", ("points", 1), "int64")]
    text = f"""({", ".join(inputs)}) => ({", ".join(value(name, one.shape) for name, one in held.items())}) {{
        mean = ReduceMean (features) zero = Sub (mean, mean)
        boxes = Add (held_boxes, zero) log_odds = Add (held_log_odds, zero)
    }}"""
    constants = {f"held_{name}": one for name, one in held.items()}
    return write_model(path, text, constants, {KEY: json.dumps(SPECS | said)})


def detect(path: Path, lidar_xy: tuple[float, float] = (0.0, 0.0)) -> Callable[[CombinedCloud], Boxes3D]:
    settings = load_config("road", (f"detect3d.model={path}", "detect3d.method=pillars"))
    return partial(boxes_found, rig((*lidar_xy, LIDAR[2])), settings)


@pytest.mark.parametrize("lidar_xy", [(0.0, 0.0), (100.0, -40.0)])
def test_boxes_stand_on_the_ground_that_was_found(tmp_path: Path, lidar_xy: tuple[float, float]) -> None:
    """The network's ground is at -1.5 m. Beside the car: the same once more, something unseen, and a doubtful one."""
    x, y, z, *size, yaw = CAR
    row = [x, y, z - 1.5, *size, np.sin(yaw), np.cos(yaw)]
    unseen = [14.0, 5.0, *row[2:]]
    boxes = detect(
        write(tmp_path / "net.onnx", [row, row, unseen, row], [[-9, 2], [-9, 1], [-9, 3], [-9, -5]]), lidar_xy
    )(combined(turned(scan(LIDAR, [CAR]), 0.0, lidar_xy)))
    assert boxes.class_ids.tolist() == [0]
    np.testing.assert_allclose(boxes.centers - [*lidar_xy, 0], [CAR[:3]], atol=1e-5)
    np.testing.assert_allclose(boxes.sizes, [size], rtol=1e-5)
    np.testing.assert_allclose(boxes.yaws, [yaw], atol=1e-5)
    np.testing.assert_allclose(boxes.scores, 1 / (1 + np.exp(-2.0)), rtol=1e-5)
    assert not len(detect(tmp_path / "net.onnx", lidar_xy)(combined(np.zeros((0, 3)))))


@pytest.mark.parametrize(
    ("said", "odds", "message"),
    [
        (
            {"features": ["x", "y", "color"]},
            [0.0, 0.0],
            "`lidcam train convert` wrote, found metadata with a fault: feat",
        ),
        ({"classes": [{"name": "tram"}]}, [0.0, 0.0], "finds tram; expected one that is a class"),
        ({"features": ["x", "y", "z"]}, [0.0, 0.0], "the network fails"),
        ({}, [0.0], r"expected finite numbers \(K, 8\) and \(K, 2\), found others"),
        ({}, [0.0, np.nan], r"expected finite numbers \(K, 8\) and \(K, 2\), found others"),
    ],
)
def test_what_a_file_lacks(tmp_path: Path, said: dict[str, object], odds: list[float], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        detect(write(tmp_path / "net.onnx", [[5.0, 0, 0, 1, 1, 1, 0, 1]], [odds], **said))(combined(scan(LIDAR, [CAR])))


def test_points_of_the_ground_and_intensities() -> None:
    """On ground that lies 0.5 m higher than the site's plane, around a lidar that is not in its middle."""
    above, ground = np.array([[6.0, 2.0, 1.5]]), np.array([[7.0, 2.0, 0.5]], np.float32)
    points = combined(above, plane=Plane(np.array([0.0, 0.0, 1.0]), -0.5))
    cloud = replace(points.detection_cloud, xyz=ground, intensity=np.array([7], np.float32))
    both = replace(points, ground_cloud=cloud)
    position, intensity = PillarPoints(rig((5.0, 0.0, 1.8)), load_config("road")).with_ground(both)
    np.testing.assert_allclose(position, [[1, 2, 1], [2, 2, 0]])
    np.testing.assert_allclose(intensity, [0, 7 / 255])

    # The first lidar reports 0 to 1, the second 0 to 255, which only its point of the ground shows.
    points = combined(np.array([[6.0, 2.0, 1.5], [6.0, 3.0, 1.5]]), np.array([[7.0, 2.0, 1.5]]))
    cloud = replace(points.detection_cloud, intensity=np.array([0.5, 1, 1], np.float32))
    ground_cloud = replace(cloud, intensity=np.array([0.25, 51, 0], np.float32))
    index = np.array([0, 1, 1], np.uint8)
    both = replace(points, detection_cloud=cloud, ground_cloud=ground_cloud, ground_lidar_index=index)
    intensity = PillarPoints(rig(LIDAR, LIDAR), load_config("road")).with_ground(both)[1]
    np.testing.assert_allclose(intensity, [0.5, 1, 1 / 255, 0.25, 0.2, 0])


def test_features_of_points() -> None:
    """Two points in one pillar, which is full, one in another, which is not, and four beyond the grid."""
    position = np.array(
        [[1.1, 0.3, 1.5], [4.0, 0.0, 0.5], [1.3, 0.4, 0.5], [-0.1, 0, 1], [16.0, 0, 1], [1, 1, 2.5], [1, 1, -1.6]]
    )
    intensity = np.array([0.2, 1, 0, 0.5, 0.5, 0.5, 0.5], np.float32)
    specs = KitSpecs.model_validate(SPECS)
    features, pillar = kit_pillars(position, intensity, specs)
    assert features.dtype == np.float32
    assert pillar.tolist() == [[32 * 32 + 8], [33 * 32 + 2], [33 * 32 + 2], [32 * 32 + 8]]
    expected = [
        [4.0, 0.0, -1.0, 255, 0, 0, 0, -0.25, -0.125, 0],
        [1.1, 0.3, 0.0, 51, -0.1, -0.05, 0.5, -0.15, -0.075, 1],
        [1.3, 0.4, -1.0, 0, 0.1, 0.05, -0.5, 0.05, 0.025, 0],
        [0.0] * 10,
    ]
    np.testing.assert_allclose(features, expected, atol=1e-6)
    anywhere = specs.model_copy(update={"max_points": 0})
    assert len(kit_pillars(position, intensity, anywhere)[1]) == 3
