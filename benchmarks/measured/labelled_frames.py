"""Labelled real frames of one lidar and one camera, and each of them as a recording of its own.

Known are folders of KITTI's object benchmark: `velodyne`, `image_2`, `calib`, `label_2` side by side.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidcam.bags.simulator.recorder.messages import MessageFactory
from lidcam.pipeline.core.arrays import F32, F64, Bools
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.evaluation.assignment import assign_nearest
from lidcam.readers.rig.importers.kitti import kitti_calibration
from lidcam.readers.truth.kitti import LEFT_COLOUR_CAMERA, KittiLabel, parse_kitti_labels
from lidcam.writers.mcap.output import mcap_file

STAMP_NS = 1_316_000_000 * 10**9
LIDAR_FRAME, CAMERA_FRAME = "velodyne", "camera_optical"


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """One labelled object."""

    label: str  # class, as the data set names it
    T_lidar_box: F64  # (4, 4) pose of its centre, x along its length
    size_m: tuple[float, float, float]  # length, width, height

    @property
    def yaw(self) -> float:
        """Heading in the lidar's frame, radians."""
        return float(np.arctan2(self.T_lidar_box[1, 0], self.T_lidar_box[0, 0]))


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """One frame with its labels."""

    name: str
    cloud: Path  # file of (N, 4) float32 x, y, z, intensity in the lidar's frame
    image: Path  # PNG file
    camera: CameraModel
    T_camera_lidar: Transform
    labels: tuple[Label, ...]
    unlabelled_xyxy: F64  # (D, 4) left, top, right, bottom of parts of the image that nobody labelled, pixels

    def points(self) -> F32:
        """(N, 4) float32 x, y, z, intensity."""
        return np.fromfile(self.cloud, np.float32).reshape(-1, 4)


def labelled_frames(folder: Path) -> Iterator[LabelledFrame]:
    """The labelled frames below a folder, by path.

    Raises:
        RecordingError: labels cannot be read.
    """
    yield from map(_of_benchmark, sorted(folder.rglob("label_2/*.txt")))


def write_recording(frame: LabelledFrame, path: Path) -> None:
    """The frame as a recording: the cloud, the image as it is, the calibration; all of one moment."""
    make, camera = MessageFactory(2), frame.camera
    points = dict(zip(("x", "y", "z", "intensity"), frame.points().T, strict=True))
    image = make.compressed_image(STAMP_NS, camera.frame_id, "png", np.fromfile(frame.image, np.uint8))
    messages = {
        "/tf_static": make.transforms(STAMP_NS, [frame.T_camera_lidar.inverse()]),
        "/camera/camera_info": make.intrinsics(STAMP_NS, camera),
        "/velodyne_points": make.cloud(STAMP_NS, LIDAR_FRAME, points),
        "/camera/image_raw/compressed": image,
    }
    with mcap_file(path, profile="ros2") as file:
        for topic, message in messages.items():
            channel = file.add_ros2(topic, message.__msgtype__, None)
            file.add_message(channel, STAMP_NS, make.serialize(message))


def _of_benchmark(labels: Path) -> LabelledFrame:
    root, name = labels.parent.parent, labels.stem
    place = root / "calib" / labels.name
    calibration = kitti_calibration(place.read_text(), place)
    if calibration is None:
        raise ValueError(f"{place}: expected a calibration of KITTI")
    found = parse_kitti_labels(labels.read_text(), labels).labels
    cloud, image = root / "velodyne" / f"{name}.bin", root / "image_2" / f"{name}.png"
    return _frame(cloud, image, calibration.projections[LEFT_COLOUR_CAMERA], calibration.T_rect_velo, found)


def _frame(
    cloud: Path, image: Path, projection: F64, T_rect_lidar: F64, labels: tuple[KittiLabel, ...]
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
    labelled = (label for label in labels if label.label != "DontCare")
    objects = tuple(Label(label.label, T_lidar_rect @ label.T_rect_box(), label.size_m) for label in labelled)
    T_camera_lidar = Transform(CAMERA_FRAME, LIDAR_FRAME, T_camera_rect @ T_rect_lidar)
    unlabelled_xyxy = np.array(unlabelled, np.float64).reshape(-1, 4)
    return LabelledFrame(cloud.stem, cloud, image, camera, T_camera_lidar, objects, unlabelled_xyxy)


def _png_size(path: Path) -> tuple[int, int]:
    """Width and height, which stand at a fixed place (PNG specification, IHDR)."""
    with path.open("rb") as file:
        head = file.read(24)
    return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")


CLASSES = {"Car": "car", "Pedestrian": "pedestrian", "Cyclist": "bicycle"}
"""Labelled classes that are counted, and the classes of the settings that they are."""

RANGE_M, GATE_M = 40.0, 2.0


@dataclass(frozen=True, slots=True)
class Count:
    """One class in one frame."""

    labels: int  # objects to find
    found: tuple[tuple[float, float], ...]  # distance of the centres on the ground (m), difference of the axes (deg)
    false: int  # boxes that are no object of this class


def count_frame(
    frame: LabelledFrame, boxes: Boxes3D, class_names: tuple[str, ...], T_site_lidar: Transform
) -> dict[str, Count]:
    """Counts of each class, by its label.

    A box finds a label of its class within `GATE_M` on the ground, one the other. Boxes on objects that are not to be
    found (further away, of another vehicle's class), in parts of the image that nobody labelled, outside the image or
    beyond `RANGE_M` are neither found nor false.
    """
    T_lidar_site = T_site_lidar.inverse()
    centers = T_lidar_site.apply(boxes.centers)
    yaws = boxes.yaws + np.arctan2(T_lidar_site.matrix[1, 0], T_lidar_site.matrix[0, 0])
    is_excused = excused(frame, centers) | (np.hypot(centers[:, 0], centers[:, 1]) > RANGE_M)
    names = np.array(class_names, object)[boxes.class_ids]
    counts = {}
    for label, name in CLASSES.items():
        of_class = names == name
        labels = [one for one in frame.labels if one.label == label and _range_m(one) <= RANGE_M]
        counts[label] = _count(labels, centers[of_class], yaws[of_class], is_excused[of_class])
    return counts


def _count(labels: list[Label], centers: F64, yaws: F64, excused: Bools) -> Count:
    places = np.array([one.T_lidar_box[:2, 3] for one in labels]).reshape(-1, 2)
    distances = np.linalg.norm(places[:, None] - centers[None, :, :2], axis=2)
    first, second = np.nonzero(distances <= GATE_M)
    chosen = assign_nearest(first, second, distances[first, second])
    first, second = first[chosen], second[chosen]
    turns = yaws[second] - np.array([labels[row].yaw for row in first])
    turns_deg = np.degrees(np.abs(wrap_angle(2 * turns)) / 2)
    is_false = ~excused
    is_false[second] = False
    found = tuple(zip(distances[first, second].tolist(), turns_deg.tolist(), strict=True))
    return Count(len(labels), found, int(is_false.sum()))


def _range_m(label: Label) -> float:
    return float(np.hypot(*label.T_lidar_box[:2, 3]))


def excused(frame: LabelledFrame, centers: F64) -> Bools:
    """Whether a box is outside the image, where nobody labelled, or on an object that is not to be found."""
    pixels, valid = frame.camera.project(frame.T_camera_lidar.apply(centers))
    inside = (pixels >= 0) & (pixels < [frame.camera.width_px, frame.camera.height_px])
    is_excused = np.asarray(~(valid & inside.all(1)))
    for left, top, right, bottom in frame.unlabelled_xyxy:
        is_excused |= ((pixels >= [left, top]) & (pixels <= [right, bottom])).all(1)
    for label in frame.labels:
        if label.label in CLASSES and _range_m(label) <= RANGE_M:
            continue
        local = (centers - label.T_lidar_box[:3, 3]) @ label.T_lidar_box[:3, :3]
        reach = np.array(label.size_m[:2]) / 2 + GATE_M
        is_excused |= (np.abs(local[:, :2]) <= reach).all(1)
    return is_excused
