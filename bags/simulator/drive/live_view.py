"""A running simulation in the Rerun viewer: clouds, images and ground truth."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from lidcam.bags.simulator.recorder.recorded import Recorded
from lidcam.bags.simulator.recorder.simulation import TRUTH_TOPIC, Simulation
from lidcam.bags.simulator.recorder.stage import T_carrier_sensor
from lidcam.bags.simulator.scenario.sensors import SensorScenario
from lidcam.bags.simulator.sensors.lens import camera_model
from lidcam.pipeline.core.ros.messages import RosMessages
from lidcam.writers.rerun.viewer import start_viewer

BOX_COLOR = (255, 170, 40)


class LiveView:
    """Shows recorded messages, in a new stream unless one is given; lidars that record packets only are not shown."""

    def __init__(self, simulation: Simulation, stream: rr.RecordingStream | None = None) -> None:
        self._stream = rr.RecordingStream("lidcam_drive") if stream is None else stream
        scenario = simulation.scenario
        self._sensors = {lidar.topic: f"{_parent(lidar)}/{name}" for name, lidar in scenario.lidars.items()}
        self._sensors |= {cam.image_topic: f"{_parent(cam)}/{name}" for name, cam in scenario.cameras.items()}
        self._messages = RosMessages(simulation.ros_version)
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, sensor in [*scenario.lidars.items(), *scenario.cameras.items()]:
            pose = T_carrier_sensor(scenario, sensor)
            placed = rr.Transform3D(translation=pose.translation, mat3x3=pose.matrix[:3, :3])
            self._stream.log(f"{_parent(sensor)}/{name}", placed, static=True)
        images = []
        for name, camera in scenario.cameras.items():
            model, entity = camera_model(camera), f"{_parent(camera)}/{name}"
            lens = rr.Pinhole(image_from_camera=model.K, resolution=[model.width_px, model.height_px])
            self._stream.log(entity, lens, static=True)
            images.append(rrb.Spatial2DView(name=name, origin=entity))
        scene = rrb.Spatial3DView(name="Scene", origin="world")
        self._stream.send_blueprint(rrb.Blueprint(rrb.Horizontal(scene, rrb.Grid(*images)), collapse_panels=True))

    def spawn(self) -> "LiveView":
        """Open the viewer.

        Raises:
            OutputError: the viewer cannot be started.
        """
        start_viewer(self._stream)
        return self

    def show(self, recorded: Sequence[Recorded]) -> None:
        """Show the messages recorded in one step."""
        for one in recorded:
            if one.topic not in self._sensors and one.topic not in (TRUTH_TOPIC, "/tf"):
                continue
            message = self._messages.deserialize(one.data, one.msgtype)
            self._stream.set_time("stamp", duration=np.timedelta64(one.stamp_ns, "ns"))
            if one.topic == TRUTH_TOPIC:
                self._stream.log("world/truth", _boxes(message))
            elif one.topic == "/tf":
                move = message.transforms[0].transform
                place = [move.translation.x, move.translation.y, move.translation.z]
                turn = rr.Quaternion(xyzw=[move.rotation.x, move.rotation.y, move.rotation.z, move.rotation.w])
                self._stream.log("world/base_link", rr.Transform3D(translation=place, rotation=turn))
            else:
                self._stream.log(self._sensors[one.topic], _drawn(one.msgtype.rpartition("/")[2], message))


def _parent(sensor: SensorScenario) -> str:
    return "world/base_link" if sensor.mounted_on else "world"


def _drawn(kind: str, message: Any) -> Any:
    """A cloud or an image as a Rerun archetype."""
    if kind == "PointCloud2":
        floats = message.data.reshape(message.width, message.point_step)[:, :12].copy().view(np.float32)
        return rr.Points3D(floats, radii=rr.Radius.ui_points(1.5))
    if kind == "CompressedImage":
        return rr.EncodedImage(contents=message.data, media_type="image/jpeg")
    return rr.Image(message.data.reshape(message.height, message.width, 3))


def _boxes(message: Any) -> Any:
    boxes = [detection.bbox for detection in message.detections]
    centers = [[box.center.position.x, box.center.position.y, box.center.position.z] for box in boxes]
    turns = [box.center.orientation for box in boxes]
    return rr.Boxes3D(
        centers=centers,
        sizes=[[box.size.x, box.size.y, box.size.z] for box in boxes],
        quaternions=[rr.Quaternion(xyzw=[turn.x, turn.y, turn.z, turn.w]) for turn in turns],
        colors=BOX_COLOR,
    )
