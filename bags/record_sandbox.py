"""Record the sample `sandbox.bag`: `python -m bags.record_sandbox OUT.bag [--seconds S] [--seed N]`.

Same seed, same bytes. Topics are the original's: /velodyneN_points, /image_raw_NN (JPEG, so with /compressed), ground
truth odometry of both cars, and beside them what a recording should have: camera_info, tf_static, and per camera the
2D boxes of a simulated detector with pixel noise, misses and false boxes, so that fusion works without any weights.
"""

import argparse
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bags.raycast import cast
from bags.sandbox_world import (
    CAMERAS,
    CAR_SIZE_M,
    CARS,
    HEIGHT_PX,
    LIDARS,
    SITE_FRAME,
    STATIC_BOXES,
    TABLE,
    WIDTH_PX,
    camera_model,
    camera_pose,
    car_boxes,
    ground_rgb,
    lidar_pose,
)
from pipeline.geometry import Transform, box_corners

__all__ = ["SandboxRecorder", "record"]

F64 = npt.NDArray[np.float64]

START_NS = 1_700_000_000_000_000_000
SWEEP_NS = 100_000_000
VLP16_ELEVATIONS_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15], np.float64)
AZIMUTH_STEPS = 900  # 0.4 degrees at 10 Hz: every second firing of a VLP-16, to keep the sample small
RANGE_NOISE_M, RANGE_STEP_M = 0.008, 0.002
PIXEL_NOISE_PX, MISS_RATE, FALSE_PER_IMAGE = 1.2, 0.06, 0.08
CAR_LABEL = 1  # the original's labels: 1 car, 2 pedestrian, 3 bicycle
SUN = np.array([0.35, -0.45, 0.82])

# vision_msgs of ROS 1 (Noetic), which rosbags' own types do not hold
VISION_MSGS = {
    "vision_msgs/msg/BoundingBox2D": "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "vision_msgs/msg/ObjectHypothesisWithPose": "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/Detection2D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox2D bbox\nsensor_msgs/Image source_img",
    "vision_msgs/msg/Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}


class SandboxRecorder:
    """Makes the messages of the sample recording; holds the message types and the random numbers."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.Generator(np.random.PCG64(seed))
        self.store = get_typestore(Stores.ROS1_NOETIC)
        for name, text in VISION_MSGS.items():
            self.store.register(get_types_from_msg(text, name))
        self.backgrounds = {name: _background(name) for name in CAMERAS}

    def new(self, msgtype: str, **fields: Any) -> Any:
        """A message object."""
        return self.store.types[msgtype](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """std_msgs/Header."""
        stamp = self.new("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.new("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id=frame_id)

    def messages(self, seconds: float) -> Iterator[tuple[int, str, Any]]:
        """(log time, topic, message), not sorted."""
        yield START_NS, "/tf_static", self.tf_static()
        for sweep in range(round(seconds * 1e9 / SWEEP_NS)):
            base_ns = START_NS + sweep * SWEEP_NS
            for number, name in enumerate(LIDARS):
                stamp_ns = base_ns + 9_000_000 * number
                yield stamp_ns + SWEEP_NS + 4_000_000, f"/{name}_points", self.cloud(name, stamp_ns)
            for number, name in enumerate(CAMERAS):
                jitter_ns = int(self.random.normal(0, 1_500_000))
                stamp_ns = base_ns + 2_000_000 * number + 3_000_000 + jitter_ns
                log_ns = stamp_ns + 12_000_000
                picture, boxes = self.picture(name, stamp_ns)
                yield log_ns, f"/image_raw_{name}/compressed", self.compressed(name, stamp_ns, picture)
                yield log_ns, f"/camera_info_{name}", self.camera_info(name, stamp_ns)
                yield log_ns + 30_000_000, f"/detections_{name}", self.detections(name, stamp_ns, boxes)
            for step in range(5):
                stamp_ns = base_ns + step * SWEEP_NS // 5
                for name in CARS:
                    yield stamp_ns + 1_000_000, f"/{name}/base_pose_ground_truth", self.odometry(name, stamp_ns)

    def tf_static(self) -> Any:
        """Extrinsics of all sensors."""
        poses = [lidar_pose(name) for name in LIDARS] + [camera_pose(name) for name in CAMERAS]
        return self.new("tf2_msgs/msg/TFMessage", transforms=[self.transform(pose) for pose in poses])

    def transform(self, pose: Transform) -> Any:
        """geometry_msgs/TransformStamped."""
        x, y, z = (float(v) for v in pose.translation)
        qx, qy, qz, qw = (float(v) for v in pose.quaternion_xyzw)
        return self.new(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(START_NS, pose.dst),
            child_frame_id=pose.src,
            transform=self.new(
                "geometry_msgs/msg/Transform",
                translation=self.new("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=self.new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
            ),
        )

    def cloud(self, name: str, stamp_ns: int) -> Any:
        """One sweep as the ROS velodyne driver writes it: x y z intensity ring time."""
        column, laser = np.divmod(np.arange(AZIMUTH_STEPS * 16), 16)
        azimuth = -2 * np.pi * column / AZIMUTH_STEPS  # Velodynes turn clockwise
        elevation = np.deg2rad(VLP16_ELEVATIONS_DEG[laser])
        offset_s = column / AZIMUTH_STEPS * SWEEP_NS * 1e-9 + laser * 2.304e-6
        rays = np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1
        )
        pose = lidar_pose(name)
        directions = rays @ pose.matrix[:3, :3].T
        seconds = (stamp_ns - START_NS) * 1e-9 + offset_s
        distance, rgb, normal, _ = _scene(pose.translation, directions, seconds, in_table_only=True)
        hit = np.isfinite(distance) & (self.random.random(len(distance)) > 0.01)
        incidence = np.abs((normal * directions).sum(1))
        intensity = np.clip(255 * rgb.mean(1) * (0.3 + 0.7 * incidence), 0, 255)
        noisy = distance + self.random.normal(0, RANGE_NOISE_M, len(distance))
        measured = np.round(np.where(hit, noisy, 0) / RANGE_STEP_M) * RANGE_STEP_M
        layout = np.dtype(
            {
                "names": ["x", "y", "z", "intensity", "ring", "time"],
                "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
                "offsets": [0, 4, 8, 12, 16, 18],
                "itemsize": 22,
            }
        )
        rings = np.argsort(np.argsort(VLP16_ELEVATIONS_DEG))[laser]
        points = np.zeros(int(hit.sum()), layout)
        xyz = (rays * measured[:, None])[hit]
        points["x"], points["y"], points["z"] = xyz.T
        points["intensity"], points["ring"], points["time"] = np.round(intensity[hit]), rings[hit], offset_s[hit]
        datatypes = {"ring": 4}
        fields = [
            self.new(
                "sensor_msgs/msg/PointField", name=n, offset=layout.fields[n][1], datatype=datatypes.get(n, 7), count=1
            )
            for n in layout.names or ()
            if layout.fields is not None
        ]
        return self.new(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(stamp_ns, name),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=22,
            row_step=22 * len(points),
            data=points.view(np.uint8).reshape(-1),
            is_dense=True,
        )

    def picture(self, name: str, stamp_ns: int) -> tuple[npt.NDArray[np.uint8], F64]:
        """(480, 640, 3) uint8 red first, and the true boxes of the cars that it shows, (M, 4) pixels."""
        distance, rgb = self.backgrounds[name]
        distance, rgb = distance.copy(), rgb.copy()
        model, pose, seconds = camera_model(name), camera_pose(name), (stamp_ns - START_NS) * 1e-9
        to_camera, shown = pose.inverse(), []
        for path in CARS.values():
            center, yaw = path.pose(seconds)
            corners = box_corners(center[None], np.array([CAR_SIZE_M]), yaw[None])
            box = model.project_boxes(to_camera.apply(corners))[0].astype(np.float64)
            if np.isnan(box).any():
                continue
            left, top, right, bottom = (int(v) for v in (*np.floor(box[:2]), *np.ceil(box[2:])))
            window = (slice(top, bottom), slice(left, right))
            directions = _camera_rays(name)[window].reshape(-1, 3)
            hit_m, hit_rgb, _, hit_car = _cars(pose.translation, directions, seconds, only=path)
            nearer = hit_car & (hit_m < distance[window].reshape(-1))
            rows = nearer.reshape(bottom - top, right - left)
            distance[window][rows], rgb[window][rows] = hit_m[nearer], hit_rgb[nearer]
            if nearer.sum() > 60 and nearer.sum() > 0.35 * hit_car.sum():
                shown.append(box)
        noisy = rgb * 255 + self.random.normal(0, 0.8, (HEIGHT_PX, WIDTH_PX, 1))
        return np.clip(noisy, 0, 255).astype(np.uint8), np.array(shown).reshape(-1, 4)

    def compressed(self, name: str, stamp_ns: int, rgb: npt.NDArray[np.uint8]) -> Any:
        """sensor_msgs/CompressedImage."""
        _, jpeg = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 70])
        header = self.header(stamp_ns, f"camera_{name}_optical")
        return self.new("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=jpeg.reshape(-1))

    def camera_info(self, name: str, stamp_ns: int) -> Any:
        """sensor_msgs/CameraInfo."""
        model = camera_model(name)
        roi = self.new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, model.frame_id),
            height=HEIGHT_PX,
            width=WIDTH_PX,
            distortion_model="plumb_bob",
            D=model.distortion.copy(),
            K=model.K.reshape(-1).copy(),
            R=np.eye(3).reshape(-1),
            P=np.c_[model.K, np.zeros(3)].reshape(-1),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )

    def detections(self, name: str, stamp_ns: int, true_boxes: F64) -> Any:
        """vision_msgs/Detection2DArray of a detector that errs."""
        seen = true_boxes[self.random.random(len(true_boxes)) >= MISS_RATE]
        boxes = seen + self.random.normal(0, PIXEL_NOISE_PX, seen.shape)
        scores = self.random.uniform(0.6, 0.95, len(boxes))
        for _ in range(int(self.random.poisson(FALSE_PER_IMAGE))):
            corner = self.random.uniform([0, 0.3 * HEIGHT_PX], [0.8 * WIDTH_PX, 0.8 * HEIGHT_PX])
            boxes = np.vstack([boxes, [*corner, *(corner + self.random.uniform(30, 120, 2))]])
            scores = np.append(scores, self.random.uniform(0.3, 0.55))
        boxes = np.clip(boxes, 0, [WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX])
        header = self.header(stamp_ns, f"camera_{name}_optical")
        return self.new(
            "vision_msgs/msg/Detection2DArray",
            header=header,
            detections=[self.detection(header, box, float(score)) for box, score in zip(boxes, scores, strict=True)],
        )

    def detection(self, header: Any, box: F64, score: float) -> Any:
        """vision_msgs/Detection2D without a source image."""
        no_image = self.new(
            "sensor_msgs/msg/Image",
            header=header,
            height=0,
            width=0,
            encoding="",
            is_bigendian=0,
            step=0,
            data=np.zeros(0, np.uint8),
        )
        x, y = float(box[0] + box[2]) / 2, float(box[1] + box[3]) / 2
        hypothesis = self.new(
            "vision_msgs/msg/ObjectHypothesisWithPose",
            id=CAR_LABEL,
            score=score,
            pose=self.new(
                "geometry_msgs/msg/PoseWithCovariance", pose=self.pose(np.zeros(3), 0.0), covariance=np.zeros(36)
            ),
        )
        bbox = self.new(
            "vision_msgs/msg/BoundingBox2D",
            center=self.new("geometry_msgs/msg/Pose2D", x=x, y=y, theta=0.0),
            size_x=float(box[2] - box[0]),
            size_y=float(box[3] - box[1]),
        )
        return self.new(
            "vision_msgs/msg/Detection2D", header=header, results=[hypothesis], bbox=bbox, source_img=no_image
        )

    def pose(self, center: F64, yaw: float) -> Any:
        """geometry_msgs/Pose."""
        x, y, z = (float(v) for v in center)
        return self.new(
            "geometry_msgs/msg/Pose",
            position=self.new("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=self.new(
                "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
            ),
        )

    def odometry(self, name: str, stamp_ns: int) -> Any:
        """nav_msgs/Odometry: the true pose of a car."""
        path = CARS[name]
        center, yaw = path.pose((stamp_ns - START_NS) * 1e-9)
        vector = "geometry_msgs/msg/Vector3"
        twist = self.new(
            "geometry_msgs/msg/Twist",
            linear=self.new(vector, x=path.speed_m_s, y=0.0, z=0.0),
            angular=self.new(vector, x=0.0, y=0.0, z=path.turn_rad_s),
        )
        return self.new(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, SITE_FRAME),
            child_frame_id=f"{name}/base_link",
            pose=self.new(
                "geometry_msgs/msg/PoseWithCovariance", pose=self.pose(center, float(yaw)), covariance=np.zeros(36)
            ),
            twist=self.new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )


def _scene(origin: F64, directions: F64, seconds: F64 | float, *, in_table_only: bool) -> tuple[F64, F64, F64, Any]:
    """Nearest hit of each ray: distance (N,), infinite for a miss; colour (N, 3); normal (N, 3); is it a car (N,)."""
    down = directions[:, 2] < -1e-9
    distance = np.where(down, -origin[2] / np.where(down, directions[:, 2], -1.0), np.inf)
    place = origin[:2] + directions[:, :2] * np.where(down, distance, 0.0)[:, None]
    x_from, x_to, y_from, y_to = TABLE
    on_table = down & (place[:, 0] > x_from) & (place[:, 0] < x_to) & (place[:, 1] > y_from) & (place[:, 1] < y_to)
    distance = np.where(on_table, distance, np.inf)
    normal = np.tile([0.0, 0.0, 1.0], (len(directions), 1))
    rgb = ground_rgb(place)
    if not in_table_only:
        fade = np.clip(0.5 + 1.5 * directions[:, 2:], 0, 1)
        room = (1 - fade) * np.array([0.30, 0.28, 0.27]) + fade * np.array([0.72, 0.76, 0.80])
        rgb = np.where(on_table[:, None], rgb * (0.35 + 0.65 * SUN[2]), room)
    for box in STATIC_BOXES:
        hit_m, hit_normal = cast(origin, directions, np.array(box.center), np.array(box.size), box.yaw)
        nearer = hit_m < distance
        distance, normal = np.where(nearer, hit_m, distance), np.where(nearer[:, None], hit_normal, normal)
        lit = np.array(box.rgb) if in_table_only else np.array(box.rgb) * _light(hit_normal)
        rgb = np.where(nearer[:, None], lit, rgb)
    car_m, car_rgb, car_normal, is_car = _cars(origin, directions, seconds) if in_table_only else _no_cars(directions)
    nearer = is_car & (car_m < distance)
    distance, rgb = np.where(nearer, car_m, distance), np.where(nearer[:, None], car_rgb, rgb)
    return distance, rgb, np.where(nearer[:, None], car_normal, normal), nearer


def _cars(origin: F64, directions: F64, seconds: F64 | float, *, only: Any = None) -> tuple[F64, F64, F64, Any]:
    distance, rgb, normal, is_car = _no_cars(directions)
    for path in CARS.values():
        if only is not None and path is not only:
            continue
        center, yaw = path.pose(seconds)
        cos, sin = np.cos(yaw), np.sin(yaw)
        for offset, size, color in car_boxes(path):
            shift = np.stack(
                [offset[0] * cos - offset[1] * sin, offset[0] * sin + offset[1] * cos, offset[2] + 0 * cos], -1
            )
            hit_m, hit_normal = cast(origin, directions, center + shift, size, yaw)
            nearer = hit_m < distance
            distance, normal = np.where(nearer, hit_m, distance), np.where(nearer[:, None], hit_normal, normal)
            rgb = np.where(nearer[:, None], np.array(color) * _light(hit_normal), rgb)
            is_car = is_car | nearer
    return distance, rgb, normal, is_car


def _no_cars(directions: F64) -> tuple[F64, F64, F64, Any]:
    n = len(directions)
    return np.full(n, np.inf), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, np.bool_)


def _light(normal: F64) -> F64:
    sun = SUN / np.linalg.norm(SUN)
    return np.asarray(0.35 + 0.65 * np.clip(normal @ sun, 0, 1))[:, None]


def _camera_rays(name: str) -> F64:
    """(480, 640, 3) unit rays through the pixel centres, in the site frame."""
    model = camera_model(name)
    u, v = np.meshgrid(np.arange(WIDTH_PX), np.arange(HEIGHT_PX))
    rays = np.stack([(u - model.K[0, 2]) / model.K[0, 0], (v - model.K[1, 2]) / model.K[1, 1], np.ones(u.shape)], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.asarray(rays @ camera_pose(name).matrix[:3, :3].T)


@cache  # the same for every recording, and the dearest part of a short one
def _background(name: str) -> tuple[F64, F64]:
    """Distance (480, 640) and colour (480, 640, 3) of everything that stands still."""
    directions = _camera_rays(name).reshape(-1, 3)
    distance, rgb, _, _ = _scene(camera_pose(name).translation, directions, 0.0, in_table_only=False)
    return distance.reshape(HEIGHT_PX, WIDTH_PX), rgb.reshape(HEIGHT_PX, WIDTH_PX, 3)


def record(path: Path, *, seconds: float, seed: int) -> None:
    """Write the recording (ROS 1, lz4); an existing file is replaced."""
    recorder = SandboxRecorder(seed)
    path.unlink(missing_ok=True)
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        connections: dict[str, Any] = {}
        ordered = sorted(recorder.messages(seconds), key=lambda item: item[:2])
        for log_ns, topic, message in ordered:
            msgtype = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=recorder.store)
            writer.write(connections[topic], log_ns, recorder.store.serialize_ros1(message, msgtype))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Record the sample sandbox.bag")
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=2.8)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    record(arguments.out, seconds=arguments.seconds, seed=arguments.seed)


if __name__ == "__main__":
    main()
