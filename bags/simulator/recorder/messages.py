"""Messages of a simulated recording: arrays and numbers to the message objects of ROS 1 or ROS 2.

Where the two differ, the class names of ROS 2 (`car`) are numbers in ROS 1, whose vision_msgs know no names: see
`CLASS_NUMBERS`, the first three of which are the original's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from bags.simulator.recorder.message_types import RosVersion, message_types
from bags.simulator.recorder.recorded import Recorded
from pipeline.core.arrays import F64, I64, U8, Array
from pipeline.core.camera import CameraModel
from pipeline.core.geometry.transform import Transform

__all__ = ["CLASS_NUMBERS", "MessageFactory", "TrueObject"]


CLASS_NUMBERS = {"car": 1, "pedestrian": 2, "cyclist": 3, "van": 4, "truck": 5, "bus": 6}
COUNT_NUMBERS = {"lidar_points": -1, "image_pixels": -2, "instance": -3}
"""ROS 1: hypotheses that tell a count, not a class."""

_DATATYPES = {"float32": 7, "uint16": 4, "uint8": 2, "uint32": 6}


@dataclass(frozen=True, slots=True, eq=False)
class TrueObject:
    """What is known of one thing at one moment.

    Attributes:
        name: In the scenario.
        class_name: A key of `CLASS_NUMBERS`.
        T_site_box: Pose of its box's centre.
        size_m: Length, width, height.
        lidar_points: Points that hit it, of all lidars, in the sweeps of that moment.
        image_pixels: Pixels that show it, of all cameras, in the images of that moment.
    """

    name: str
    class_name: str
    T_site_box: Transform
    size_m: tuple[float, float, float]
    lidar_points: int
    image_pixels: int


class MessageFactory:
    """Makes message objects; their class names are the same for both versions.

    Args:
        ros_version: Whose definitions.
        start_ns: Time of the scenario's first moment: all times given to the methods count from there.
    """

    def __init__(self, ros_version: RosVersion, start_ns: int) -> None:
        self.ros_version, self.start_ns = ros_version, start_ns
        self.types = message_types(ros_version)

    def new(self, msgtype: str, **fields: Any) -> Any:
        """A message object."""
        return self.types.types[msgtype](**fields)

    def recorded(self, log_ns: int, topic: str, stamp_ns: int, message: Any, *, latched: bool = False) -> Recorded:
        """A message object as it is recorded."""
        msgtype = message.__msgtype__
        serialize = self.types.serialize_ros1 if self.ros_version == 1 else self.types.serialize_cdr
        return Recorded(log_ns, topic, stamp_ns, msgtype, bytes(serialize(message, msgtype)), latched)

    def time(self, time_ns: int) -> Any:
        """builtin_interfaces/Time."""
        seconds, nanoseconds = divmod(self.start_ns + time_ns, 10**9)
        return self.new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """std_msgs/Header; ROS 1's `seq` is left at 0, as bags of ROS 1 nodes in Python have it before publishing."""
        seq = {"seq": 0} if self.ros_version == 1 else {}
        return self.new("std_msgs/msg/Header", stamp=self.time(stamp_ns), frame_id=frame_id, **seq)

    # --- sensors

    def cloud(self, stamp_ns: int, frame_id: str, fields: dict[str, Array]) -> Any:
        """sensor_msgs/PointCloud2 of one row, as the ROS driver writes it: fields side by side, little endian.

        Args:
            stamp_ns: Of the sweep's first firing.
            frame_id: Of the points.
            fields: Arrays (N,) by the field's name, in their order.
        """
        layout = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in fields.items()])
        points = np.empty(len(next(iter(fields.values()))), layout)
        for name, values in fields.items():
            points[name] = values
        offsets = np.cumsum([0, *(values.dtype.itemsize for values in fields.values())])
        described = [
            self.new(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=int(offset),
                datatype=_DATATYPES[values.dtype.name],
                count=1,
            )
            for (name, values), offset in zip(fields.items(), offsets[:-1], strict=True)
        ]
        return self.new(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(stamp_ns, frame_id),
            height=1,
            width=len(points),
            fields=described,
            is_bigendian=False,
            point_step=layout.itemsize,
            row_step=layout.itemsize * len(points),
            data=points.view(np.uint8).reshape(-1),
            is_dense=True,
        )

    def scan(self, stamp_ns: int, frame_id: str, stamps_ns: I64, payload: U8) -> Any:
        """velodyne_msgs/VelodyneScan of packets (P, 1206), stamped by the driver (P,)."""
        packets = [
            self.new("velodyne_msgs/msg/VelodynePacket", stamp=self.time(int(stamp)), data=data)
            for stamp, data in zip(stamps_ns, payload, strict=True)
        ]
        return self.new("velodyne_msgs/msg/VelodyneScan", header=self.header(stamp_ns, frame_id), packets=packets)

    def image(self, stamp_ns: int, frame_id: str, rgb: U8) -> Any:
        """sensor_msgs/Image, rgb8, of an image (H, W, 3)."""
        height, width, _ = rgb.shape
        return self.new(
            "sensor_msgs/msg/Image",
            header=self.header(stamp_ns, frame_id),
            height=height,
            width=width,
            encoding="rgb8",
            is_bigendian=0,
            step=3 * width,
            data=rgb.reshape(-1),
        )

    def jpeg(self, stamp_ns: int, frame_id: str, rgb: U8, quality: int) -> Any:
        """sensor_msgs/CompressedImage, JPEG, of an image (H, W, 3)."""
        _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
        header = self.header(stamp_ns, frame_id)
        return self.new("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=data.reshape(-1))

    def camera_info(self, stamp_ns: int, model: CameraModel) -> Any:
        """sensor_msgs/CameraInfo."""
        roi = self.new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        matrices = {
            "d": model.distortion.copy(),
            "k": model.K.reshape(-1).copy(),
            "r": np.eye(3).reshape(-1),
            "p": np.c_[model.K, np.zeros(3)].reshape(-1),
        }
        named = {key.upper() if self.ros_version == 1 else key: value for key, value in matrices.items()}
        return self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, model.frame_id),
            height=model.height_px,
            width=model.width_px,
            distortion_model=model.model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **named,
        )

    # --- frames and motion

    def transforms(self, stamp_ns: int, transforms: Sequence[Transform]) -> Any:
        """tf2_msgs/TFMessage."""
        return self.new("tf2_msgs/msg/TFMessage", transforms=[self._transform(stamp_ns, one) for one in transforms])

    def _transform(self, stamp_ns: int, transform: Transform) -> Any:
        return self.new(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, transform.dst),
            child_frame_id=transform.src,
            transform=self.new(
                "geometry_msgs/msg/Transform",
                translation=self._vector(*transform.translation),
                rotation=self._quaternion(transform),
            ),
        )

    def odometry(self, stamp_ns: int, pose: Transform, velocity: tuple[float, float, float]) -> Any:
        """nav_msgs/Odometry without noise.

        Args:
            stamp_ns: True time.
            pose: Of the child frame.
            velocity: Along x and y of the child frame (m/s), and about its z (rad/s), as its definition wants.
        """
        along, across, turn = velocity
        twist = self.new(
            "geometry_msgs/msg/Twist", linear=self._vector(along, across, 0), angular=self._vector(0, 0, turn)
        )
        return self.new(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, pose.dst),
            child_frame_id=pose.src,
            pose=self._pose_with_covariance(self._pose(pose)),
            twist=self.new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def drive(self, stamp_ns: int, frame_id: str, *, speed_m_s: float, steering_rad: float) -> Any:
        """ackermann_msgs/AckermannDriveStamped."""
        drive = self.new(
            "ackermann_msgs/msg/AckermannDrive",
            steering_angle=steering_rad,
            steering_angle_velocity=0.0,
            speed=speed_m_s,
            acceleration=0.0,
            jerk=0.0,
        )
        return self.new("ackermann_msgs/msg/AckermannDriveStamped", header=self.header(stamp_ns, frame_id), drive=drive)

    def number(self, value: float) -> Any:
        """std_msgs/Float64."""
        return self.new("std_msgs/msg/Float64", data=float(value))

    # --- boxes

    def detections_2d(
        self, stamp_ns: int, frame_id: str, boxes_xyxy: F64, scores: F64, class_names: Sequence[str]
    ) -> Any:
        """vision_msgs/Detection2DArray of boxes (M, 4): left, top, right, bottom in pixels."""
        header = self.header(stamp_ns, frame_id)
        detections = []
        for index, (box, score, name) in enumerate(zip(boxes_xyxy, scores, class_names, strict=True)):
            left, top, right, bottom = (float(edge) for edge in box)
            x, y = (left + right) / 2, (top + bottom) / 2
            if self.ros_version == 1:
                center = self.new("geometry_msgs/msg/Pose2D", x=x, y=y, theta=0.0)
                more = {"source_img": self._no_image(header)}
            else:
                position = self.new("vision_msgs/msg/Point2D", x=x, y=y)
                center = self.new("vision_msgs/msg/Pose2D", position=position, theta=0.0)
                more = {"id": str(index)}
            size = {"size_x": right - left, "size_y": bottom - top}
            detections.append(
                self.new(
                    "vision_msgs/msg/Detection2D",
                    header=header,
                    results=[self._hypothesis(name, float(score), self._pose(Transform.identity("", "")))],
                    bbox=self.new("vision_msgs/msg/BoundingBox2D", center=center, **size),
                    **more,
                )
            )
        return self.new("vision_msgs/msg/Detection2DArray", header=header, detections=detections)

    def truth(self, stamp_ns: int, frame_id: str, objects: Sequence[TrueObject]) -> Any:
        """vision_msgs/Detection3DArray of what is there, each with its class and its counts as hypotheses.

        ROS 2 has the name as `id`; ROS 1 has no place for it and gets its row as a count.
        """
        header = self.header(stamp_ns, frame_id)
        detections = []
        for row, thing in enumerate(objects):
            pose = self._pose(thing.T_site_box)
            counts = {"lidar_points": thing.lidar_points, "image_pixels": thing.image_pixels}
            if self.ros_version == 1:
                counts["instance"] = row
                more = {"source_cloud": self.cloud(stamp_ns, frame_id, {"x": np.empty(0, np.float32)})}
            else:
                more = {"id": thing.name}
            results = [self._hypothesis(thing.class_name, 1.0, pose)]
            results += [self._hypothesis(key, float(count), pose) for key, count in counts.items()]
            bbox = self.new("vision_msgs/msg/BoundingBox3D", center=pose, size=self._vector(*thing.size_m))
            detections.append(
                self.new("vision_msgs/msg/Detection3D", header=header, results=results, bbox=bbox, **more)
            )
        return self.new("vision_msgs/msg/Detection3DArray", header=header, detections=detections)

    def _hypothesis(self, class_name: str, score: float, pose: Any) -> Any:
        posed = self._pose_with_covariance(pose)
        if self.ros_version == 1:
            number = COUNT_NUMBERS.get(class_name) or CLASS_NUMBERS[class_name]
            return self.new("vision_msgs/msg/ObjectHypothesisWithPose", id=number, score=score, pose=posed)
        hypothesis = self.new("vision_msgs/msg/ObjectHypothesis", class_id=class_name, score=score)
        return self.new("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=posed)

    def _pose_with_covariance(self, pose: Any) -> Any:
        return self.new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))

    def _pose(self, pose: Transform) -> Any:
        x, y, z = (float(value) for value in pose.translation)
        position = self.new("geometry_msgs/msg/Point", x=x, y=y, z=z)
        return self.new("geometry_msgs/msg/Pose", position=position, orientation=self._quaternion(pose))

    def _quaternion(self, pose: Transform) -> Any:
        x, y, z, w = (float(value) for value in pose.quaternion_xyzw)
        return self.new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self.new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def _no_image(self, header: Any) -> Any:
        return self.new(
            "sensor_msgs/msg/Image",
            header=header,
            height=0,
            width=0,
            encoding="",
            is_bigendian=0,
            step=0,
            data=np.zeros(0, np.uint8),
        )
