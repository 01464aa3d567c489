"""Errors of sensors as real recordings have them, drawn from the seed of a scenario.

They stay the same throughout a recording, so that no smoothing removes them: what is recorded of a sensor is slightly
beside what the sensor does.
"""

from typing import Any, TypeVar

import numpy as np

from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario, Miscalibration, Vector
from lidcam.bags.simulator.sensors.timing import random_numbers
from lidcam.pipeline.core.settings.model import SettingsModel

# Ranges of errors.
CAMERA_TURN_DEG = (0.1, 0.3)  # rotation of cameras: drives of KITTI, whose calibration is careful, have 0.12 to 0.15
CAMERA_CLOCK_MS = (5.0, 20.0)  # time of cameras, early or late: from an exposure to the read-out of a rolling shutter
LIDAR_OFFSET_CM = (1.0, 3.0)  # mounting of lidars: what a tape measure leaves
EDGE_BIAS = 0.03
"""Maximum bias of an edge of a detector's boxes, in widths or heights of the box: the medians of YOLOX nano on what
KITTI labels as whole are 1.5 to 2.8 %, inward left, above and right, outward below.
"""

Settings = TypeVar("Settings", bound=SettingsModel)


def with_errors(scenario: Scenario) -> Scenario:
    """The scenario with errors of all sensors; an error that its settings have already stays."""
    lidars = {name: erring_lidar(lidar, name, scenario.seed) for name, lidar in scenario.lidars.items()}
    cameras = {name: _erring_camera(camera, name, scenario.seed) for name, camera in scenario.cameras.items()}
    return scenario.model_copy(update={"lidars": lidars, "cameras": cameras})


def erring_lidar(lidar: LidarScenario, name: str, seed: int, number: int = 0) -> LidarScenario:
    """The lidar with a mounting error; `number` tells lidars of one name apart."""
    draw = random_numbers(seed, name, "errors", number)
    return _unless_given(lidar, miscalibration=Miscalibration(xyz_cm=_vector(draw, LIDAR_OFFSET_CM)))


def _erring_camera(camera: CameraScenario, name: str, seed: int) -> CameraScenario:
    """The camera with errors of rotation and time, and a habit of its detector."""
    draw = random_numbers(seed, name, "errors", 0)
    error = Miscalibration(rpy_deg=_vector(draw, CAMERA_TURN_DEG))
    clock_ms = round(float(draw.choice((-1, 1)) * draw.uniform(*CAMERA_CLOCK_MS)), 2)
    bias = tuple(draw.uniform(-EDGE_BIAS, EDGE_BIAS, 4).round(4).tolist())
    detector = camera.detector and _unless_given(camera.detector, edge_bias=bias)
    found = _unless_given(camera, miscalibration=error, clock_offset_ms=clock_ms)
    return found.model_copy(update={"detector": detector})


def _vector(draw: np.random.Generator, lengths: tuple[float, float]) -> Vector:
    """A vector of any direction, whose length lies in a range."""
    direction = draw.standard_normal(3)
    x, y, z = (direction * draw.uniform(*lengths) / np.linalg.norm(direction)).round(4).tolist()
    return x, y, z


def _unless_given(settings: Settings, **errors: Any) -> Settings:
    """The settings with these errors in place of defaults."""
    fields = type(settings).model_fields
    kept = {name: error for name, error in errors.items() if getattr(settings, name) == fields[name].default}
    return settings.model_copy(update=kept)
