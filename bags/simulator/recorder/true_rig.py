"""A scenario's calibration: the true one as a rig, and the recorded one as transforms."""

from lidcam.bags.simulator.scenario.scenario import EGO_FRAME, Scenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, SensorScenario
from lidcam.bags.simulator.sensors.lens import camera_model
from lidcam.bags.simulator.world.motion import T_BODY_OPTICAL
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig, default_zones


def carrier_frame(scenario: Scenario, sensor: SensorScenario) -> str:
    """The frame that one sensor is mounted in."""
    return EGO_FRAME if sensor.mounted_on else scenario.site_frame


def T_carrier_sensor(scenario: Scenario, sensor: SensorScenario) -> Transform:
    """The true pose of the sensor's frame (for a camera the optical frame) on its carrier."""
    return _framed(sensor.T_carrier_body(carrier_frame(scenario, sensor)), sensor)


def recorded_extrinsics(scenario: Scenario) -> list[Transform]:
    """The transforms in /tf_static, whose errors are those of the scenario."""
    sensors = scenario.sensors.values()
    return [_framed(sensor.T_carrier_recorded(carrier_frame(scenario, sensor)), sensor) for sensor in sensors]


def _framed(body: Transform, sensor: SensorScenario) -> Transform:
    """The same pose for the frame of the sensor's messages."""
    if not isinstance(sensor, CameraScenario):
        return body
    return Transform(body.dst, body.src, body.matrix @ T_BODY_OPTICAL.matrix)


def true_rig(scenario: Scenario) -> Rig:
    """The true rig: the sensors of the ego vehicle if there is one, else those of the site.

    The sandbox has the zones of the predecessor system.
    """
    frame = EGO_FRAME if scenario.ego else scenario.site_frame
    lidars, cameras = [], []
    for name, lidar in scenario.lidars.items():
        if carrier_frame(scenario, lidar) == frame:
            topic = lidar.packets_topic if lidar.output == "packets" else lidar.topic
            lidars.append(LidarSensor(name, topic, T_carrier_sensor(scenario, lidar)))
    for name, camera in scenario.cameras.items():
        if carrier_frame(scenario, camera) == frame:
            boxes_topic = camera.detector.topic if camera.detector else ""
            T_camera_carrier = T_carrier_sensor(scenario, camera).inverse()
            cameras.append(CameraSensor(name, camera.image_topic, boxes_topic, camera_model(camera), T_camera_carrier))
    zones = default_zones() if scenario.world == "sandbox" else ()
    return Rig(frame, tuple(lidars), tuple(cameras), zones, ground_height_m=0.0)
