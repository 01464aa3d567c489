"""The messages of a simulated recording, for ROS 1 or ROS 2."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np

from lidcam.bags.simulator.recorder.recorded import Recorded
from lidcam.pipeline.core.arrays import I64, U8
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.ros import vision_numbers as numbers
from lidcam.pipeline.core.ros.messages import RosMessages

NO_POSE = (0.0, 0.0, 0.0)
FIRST_NUMBERS = {numbers.LIDAR_POINTS: numbers.OF_LIDAR, numbers.IMAGE_PIXELS: numbers.OF_CAMERA}


class Hypothesis(NamedTuple):
    """A hypothesis of a detection: the object's class, or a count or share, which has a negative number."""

    name: str  # `class_id` in ROS 2
    number: int  # `id` in ROS 1
    score: float  # the count or share if it is none


def class_of(name: str, score: float = 1.0) -> Hypothesis:
    """The class of an object, a key of `CLASS_NUMBERS`."""
    return Hypothesis(name, numbers.CLASS_NUMBERS[name], score)


def counted(name: str, value: float) -> Hypothesis:
    """A count or share of an object, by its name in `COUNT_NUMBERS`."""
    return Hypothesis(name, numbers.COUNT_NUMBERS[name], float(value))


def seen_by(name: str, count: int, sensor: str, row: int) -> Hypothesis:
    """A count of one lidar or camera, given by its name and its row among them."""
    return Hypothesis(f"{name}/{sensor}", FIRST_NUMBERS[name] - row, float(count))


@dataclass(frozen=True, slots=True, eq=False)
class TrueObject:
    """One object of the ground truth at one moment."""

    name: str  # in the scenario
    row: int  # in the ground truth
    T_site_box: Transform  # pose of the box's centre
    size_m: tuple[float, float, float]  # length, width, height
    hypotheses: tuple[Hypothesis, ...]  # its class, then counts


@dataclass(frozen=True, slots=True, eq=False)
class ViewedObject:
    """One box in an image."""

    name: str  # of the object that it shows, in the scenario; empty for none
    row: int  # of that object in the ground truth; -1 for none
    xyxy: Sequence[float]  # (4,) left, top, right, bottom in pixels, from the image's corner
    hypotheses: tuple[Hypothesis, ...]  # its class, then counts and shares


class MessageFactory(RosMessages):
    """Builds the messages of a simulation, which begins at `start_ns`."""

    def recorded(self, log_ns: int, topic: str, stamp_ns: int, message: Any, *, latched: bool = False) -> Recorded:
        """The serialised message with its topic and times."""
        return Recorded(log_ns, topic, stamp_ns, message.__msgtype__, self.serialize(message), latched)

    def scan(self, stamp_ns: int, frame_id: str, stamps_ns: I64, payload: U8) -> Any:
        """velodyne_msgs/VelodyneScan of packets (P, 1206), stamped by the driver (P,)."""
        packets = [
            self.new("velodyne_msgs/msg/VelodynePacket", stamp=self.time(int(stamp)), data=data)
            for stamp, data in zip(stamps_ns, payload, strict=True)
        ]
        return self.new("velodyne_msgs/msg/VelodyneScan", header=self.header(stamp_ns, frame_id), packets=packets)

    def rgb_image(self, stamp_ns: int, frame_id: str, rgb: U8) -> Any:
        """sensor_msgs/Image, rgb8, of an image (H, W, 3)."""
        height, width, _ = rgb.shape
        data = rgb.reshape(-1)
        return self.image(stamp_ns, frame_id, height=height, width=width, encoding="rgb8", step=3 * width, data=data)

    def jpeg(self, stamp_ns: int, frame_id: str, rgb: U8, quality: int) -> Any:
        """sensor_msgs/CompressedImage, JPEG, of an image (H, W, 3)."""
        _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
        return self.compressed_image(stamp_ns, frame_id, "jpeg", data.reshape(-1))

    def intrinsics(self, stamp_ns: int, model: CameraModel) -> Any:
        """sensor_msgs/CameraInfo."""
        width, height, k = model.width_px, model.height_px, model.K.reshape(9)
        lens, d = model.model, model.distortion
        return self.camera_info(stamp_ns, model.frame_id, width=width, height=height, distortion_model=lens, d=d, k=k)

    def odometry(self, stamp_ns: int, pose: Transform, velocity: tuple[float, float, float]) -> Any:
        """nav_msgs/Odometry without noise; velocity along the child frame's x, y (m/s) and about its z (rad/s)."""
        along, across, turn = velocity
        twist = self.new("geometry_msgs/msg/Twist", self.vector(along, across, 0), self.vector(0, 0, turn))
        return self.new(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, pose.dst),
            child_frame_id=pose.src,
            pose=self.pose_with_covariance(self._pose(pose)),
            twist=self.new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def drive(self, stamp_ns: int, frame_id: str, *, speed_m_s: float, steering_rad: float) -> Any:
        """ackermann_msgs/AckermannDriveStamped."""
        (drive,) = self.rows("ackermann_msgs/msg/AckermannDrive", 1, steering_angle=steering_rad, speed=speed_m_s)
        return self.new("ackermann_msgs/msg/AckermannDriveStamped", header=self.header(stamp_ns, frame_id), drive=drive)

    def number(self, value: float) -> Any:
        """std_msgs/Float64."""
        return self.new("std_msgs/msg/Float64", data=float(value))

    def detections_2d(self, stamp_ns: int, frame_id: str, objects: Sequence[ViewedObject]) -> Any:
        """vision_msgs/Detection2DArray.

        In ROS 2 `id` is the object's name; ROS 1 has no such field and gets the object's row as the last hypothesis.
        """
        header, detections = self.header(stamp_ns, frame_id), []
        for viewed in objects:
            left, top, right, bottom = viewed.xyxy
            x, y = (left + right) / 2, (top + bottom) / 2
            if self.ros_version == 1:
                center = self.new("geometry_msgs/msg/Pose2D", x, y, 0.0)
                no_data = np.zeros(0, np.uint8)
                no_image = self.image(stamp_ns, frame_id, height=0, width=0, encoding="", step=0, data=no_data)
                more = {"source_img": no_image}
            else:
                center = self.new("vision_msgs/msg/Pose2D", self.new("vision_msgs/msg/Point2D", x, y), 0.0)
                more = {"id": viewed.name}
            bbox = self.new("vision_msgs/msg/BoundingBox2D", center, right - left, bottom - top)
            results = self._results(viewed, self.pose(NO_POSE))
            detections.append(
                self.new("vision_msgs/msg/Detection2D", header=header, results=results, bbox=bbox, **more)
            )
        return self.new("vision_msgs/msg/Detection2DArray", header, detections)

    def truth(self, stamp_ns: int, frame_id: str, objects: Sequence[TrueObject]) -> Any:
        """vision_msgs/Detection3DArray of the ground truth; the object is identified as by `detections_2d`."""
        header, detections = self.header(stamp_ns, frame_id), []
        for true in objects:
            pose, more = self._pose(true.T_site_box), {"id": true.name}
            if self.ros_version == 1:
                more = {"source_cloud": self.cloud(stamp_ns, frame_id, {"x": np.empty(0, np.float32)})}
            bbox = self.new("vision_msgs/msg/BoundingBox3D", pose, self.vector(*true.size_m))
            results = self._results(true, pose)
            detections.append(
                self.new("vision_msgs/msg/Detection3D", header=header, results=results, bbox=bbox, **more)
            )
        return self.new("vision_msgs/msg/Detection3DArray", header, detections)

    def _results(self, thing: TrueObject | ViewedObject, pose: Any) -> list[Any]:
        """vision_msgs/ObjectHypothesisWithPose, each with the same pose."""
        posed, kind = self.pose_with_covariance(pose), "vision_msgs/msg/ObjectHypothesisWithPose"
        if self.ros_version == 1:
            numbered = (*thing.hypotheses, counted("instance", thing.row))
            return [self.new(kind, one.number, one.score, posed) for one in numbered]
        hypothesis = "vision_msgs/msg/ObjectHypothesis"
        return [self.new(kind, self.new(hypothesis, one.name, one.score), posed) for one in thing.hypotheses]

    def _pose(self, pose: Transform) -> Any:
        return self.pose(pose.translation.tolist(), pose.quaternion_xyzw.tolist())
