"""Labelled real frames of one lidar and one camera, and each of them as a recording of its own.

Known are folders of KITTI's object benchmark (`velodyne`, `image_2`, `calib`, `label_2` side by side), and folders of
one frame with `info_from_pkl.json`, as mmdetection3d keeps them in its demo data.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.rig.importers.kitti import kitti_calibration
from lidcam.readers.truth.kitti import LEFT_COLOUR_CAMERA, KittiLabel, parse_kitti_labels

STAMP_NS = 1_316_000_000 * 10**9
LIDAR_FRAME, CAMERA_FRAME = "velodyne", "camera_optical"


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """One labelled object.

    Attributes:
        label: Class, as the data set names it.
        T_lidar_box: (4, 4) pose of its centre, x along its length.
        size_m: Length, width, height.
    """

    label: str
    T_lidar_box: F64
    size_m: tuple[float, float, float]

    @property
    def yaw(self) -> float:
        """Heading in the lidar's frame, radians."""
        return float(np.arctan2(self.T_lidar_box[1, 0], self.T_lidar_box[0, 0]))


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """One frame with its labels.

    Attributes:
        name: To be printed.
        cloud: File of (N, 4) float32 x, y, z, intensity in the lidar's frame.
        image: PNG file.
        camera: Intrinsics of the camera.
        T_camera_lidar: Its pose.
        labels: The objects.
        unlabelled_xyxy: (D, 4) left, top, right, bottom of parts of the image that nobody labelled, pixels.
    """

    name: str
    cloud: Path
    image: Path
    camera: CameraModel
    T_camera_lidar: Transform
    labels: tuple[Label, ...]
    unlabelled_xyxy: F64

    def points(self) -> F32:
        """(N, 4) float32 x, y, z, intensity."""
        return np.fromfile(self.cloud, np.float32).reshape(-1, 4)


def labelled_frames(folder: Path) -> Iterator[LabelledFrame]:
    """The labelled frames below a folder, by path.

    Raises:
        RecordingError: labels cannot be read.
    """
    for path in sorted([*folder.rglob("label_2/*.txt"), *folder.rglob("info_from_pkl.json")]):
        yield from _of_benchmark(path) if path.suffix == ".txt" else _of_information(path)


def write_recording(frame: LabelledFrame, path: Path) -> None:
    """The frame as a recording: the cloud, the image as it is, the calibration; all of one moment."""
    points, camera = frame.points(), frame.camera
    messages = {
        "/tf_static": ROS2.transforms(STAMP_NS, [frame.T_camera_lidar.inverse()]),
        "/camera/camera_info": ROS2.camera_info(
            STAMP_NS,
            camera.frame_id,
            width=camera.width_px,
            height=camera.height_px,
            distortion_model=camera.model,
            d=camera.distortion,
            k=camera.K.reshape(9),
        ),
        "/velodyne_points": ROS2.cloud(
            STAMP_NS, LIDAR_FRAME, dict(zip(("x", "y", "z", "intensity"), points.T, strict=True))
        ),
        "/camera/image_raw/compressed": ROS2.compressed_image(
            STAMP_NS, camera.frame_id, "png", np.fromfile(frame.image, np.uint8)
        ),
    }
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        for topic, message in messages.items():
            name = message.__msgtype__
            schema = writer.register_schema(name, "ros2msg", ROS2.definition(name).encode())
            channel = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channel, STAMP_NS, bytes(ROS2.serialize(message)), STAMP_NS)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part


def _of_benchmark(labels: Path) -> Iterator[LabelledFrame]:
    root, name = labels.parent.parent, labels.stem
    place = root / "calib" / labels.name
    calibration = kitti_calibration(place.read_text(), place)
    if calibration is None:
        raise ValueError(f"{place}: expected a calibration of KITTI")
    found = parse_kitti_labels(labels.read_text(), labels).labels
    yield _frame(
        name,
        root / "velodyne" / f"{name}.bin",
        root / "image_2" / f"{name}.png",
        calibration.projections[LEFT_COLOUR_CAMERA],
        calibration.T_rect_velo,
        found,
    )


def _of_information(path: Path) -> Iterator[LabelledFrame]:
    for scene in json.loads(path.read_text())["data_list"]:
        camera, folder = scene["images"]["CAM2"], path.parent
        names = {number: name for name, number in _CATEGORIES.items()}
        found = []
        for one in scene["instances"]:
            x, y, z, length, height, width, rotation_y = one["bbox_3d"]
            label = names.get(one["bbox_label_3d"], "DontCare")
            size_m, bottom_m = (length, width, height), (x, y, z)
            found.append(
                KittiLabel(label, one["truncated"], one["occluded"], tuple(one["bbox"]), size_m, bottom_m, rotation_y)
            )
        image = folder / Path(camera["img_path"]).name
        cloud = folder / Path(scene["lidar_points"]["lidar_path"]).name
        yield _frame(
            cloud.stem, cloud, image, np.array(camera["cam2img"])[:3], np.array(camera["lidar2cam"]), tuple(found)
        )


_CATEGORIES = {"Pedestrian": 0, "Cyclist": 1, "Car": 2, "Van": 3, "Truck": 4, "Person_sitting": 5, "Tram": 6, "Misc": 7}
"""Numbers of mmdetection3d's KittiDataset."""


def _frame(
    name: str, cloud: Path, image: Path, projection: F64, T_rect_lidar: F64, labels: tuple[KittiLabel, ...]
) -> LabelledFrame:
    """A frame of rectified images: the last column of the projection is where the camera is."""
    K = np.ascontiguousarray(projection[:, :3])
    K[2] = 0.0, 0.0, 1.0
    T_camera_rect = np.eye(4)
    T_camera_rect[:3, 3] = np.linalg.solve(K, projection[:, 3])
    width_px, height_px = _png_size(image)
    camera = CameraModel(CAMERA_FRAME, width_px, height_px, K, "plumb_bob", np.zeros(5))
    T_lidar_rect = np.linalg.inv(T_rect_lidar)
    unlabelled = [label.xyxy for label in labels if label.label == "DontCare"]
    return LabelledFrame(
        name,
        cloud,
        image,
        camera,
        Transform(CAMERA_FRAME, LIDAR_FRAME, T_camera_rect @ T_rect_lidar),
        tuple(
            Label(label.label, T_lidar_rect @ label.T_rect_box(), label.size_m)
            for label in labels
            if label.label != "DontCare"
        ),
        np.array(unlabelled, np.float64).reshape(-1, 4),
    )


def _png_size(path: Path) -> tuple[int, int]:
    """Width and height, which stand at a fixed place (PNG specification, IHDR)."""
    with path.open("rb") as file:
        head = file.read(24)
    return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
