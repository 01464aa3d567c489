"""Boxes of a network in pillars, fitted to their points."""

from pathlib import Path

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan
from pillar_files import numbers_of, write_pillars

from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.stages.detect3d import Detect3D

CAR: Box = (8.2, -3.1, 0.8, 4.2, 1.75, 1.5, 2.5)
LIDAR = (0.0, 0.0, 1.8)


@pytest.mark.parametrize(
    ("turn", "is_fitted"), [(0.15, True), (np.pi - 0.15, True), (1.4, False)], ids=["ahead", "reversed", "across"]
)
def test_the_points_say_where_and_the_network_which_way(tmp_path: Path, turn: float, is_fitted: bool) -> None:
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
