"""A scenario's calibration: the true one as a rig, and the recorded one as transforms."""

import numpy as np
from scipy.spatial.transform import Rotation

from bags.simulator.scenario.scenario import EGO_FRAME, Scenario
from bags.simulator.scenario.sensors import CameraScenario, SensorScenario
from pipeline.core.camera import CameraModel
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor, LidarSensor, Rig, default_zones

__all__ = ["T_carrier_sensor", "carrier_frame", "recorded_extrinsics", "rig_frame", "true_rig"]

OPTICAL = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From a camera's optical axes (x right, y down, z forward) to its body's (x forward, y left, z up); REP 103."""


def rig_frame(scenario: Scenario) -> str:
    """The frame that the sensors are fixed to: the ego vehicle's if there is one, else the site frame."""
    return EGO_FRAME if scenario.ego else scenario.site_frame


def carrier_frame(scenario: Scenario, sensor: SensorScenario) -> str:
    """The frame that one sensor is mounted in."""
    return EGO_FRAME if sensor.mounted_on else scenario.site_frame


def T_carrier_sensor(scenario: Scenario, sensor: SensorScenario) -> Transform:
    """The true pose of the sensor's frame (for a camera the optical frame) on its carrier."""
    return _framed(sensor.T_carrier_body(carrier_frame(scenario, sensor)), sensor)


def recorded_extrinsics(scenario: Scenario) -> list[Transform]:
    """The transforms in /tf_static: the true extrinsics with the scenario's miscalibration."""
    found = []
    for sensor in scenario.sensors.values():
        true, error = sensor.T_carrier_body(carrier_frame(scenario, sensor)), np.eye(4)
        error[:3, :3] = Rotation.from_euler("xyz", sensor.miscalibration.rpy_deg, degrees=True).as_matrix()
        error[:3, 3] = np.array(sensor.miscalibration.xyz_cm) / 100
        found.append(_framed(Transform(true.dst, true.src, true.matrix @ error), sensor))
    return found


def _framed(body: Transform, sensor: SensorScenario) -> Transform:
    """The same pose for the frame of the sensor's messages."""
    return Transform(body.dst, body.src, body.matrix @ OPTICAL) if isinstance(sensor, CameraScenario) else body


def true_rig(scenario: Scenario, models: dict[str, CameraModel]) -> Rig:
    """The true rig, with the sensors that are fixed to its frame.

    Args:
        scenario: The scenario.
        models: Intrinsics by camera name.
    """
    frame = rig_frame(scenario)
    lidars = [
        LidarSensor(
            name,
            lidar.packets_topic if lidar.output == "packets" else lidar.topic,
            T_carrier_sensor(scenario, lidar),
        )
        for name, lidar in scenario.lidars.items()
        if carrier_frame(scenario, lidar) == frame
    ]
    cameras = [
        CameraSensor(
            name,
            camera.image_topic,
            camera.detector.topic if camera.detector else "",
            models[name],
            T_carrier_sensor(scenario, camera).inverse(),
        )
        for name, camera in scenario.cameras.items()
        if carrier_frame(scenario, camera) == frame
    ]
    return Rig(frame, tuple(lidars), tuple(cameras), default_zones(), ground_height_m=0.0)
