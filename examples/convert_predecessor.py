"""Converts a data set of the predecessor system to a recording that lidcam processes and evaluates.

    python examples/convert_predecessor.py test_dataset drive.mcap --calibration geometry.yaml
    lidcam process drive.mcap result.mcap --config sandbox --model-2d yolox.onnx
    lidcam evaluate result.mcap

The folder holds `pcd/N.txt` (the combined cloud of frame N, a line x y z intensity for each point), `img/N/0.jpg` to
`7.jpg` (cameras 11 to 14 and 41 to 44) and `odom/30000.txt` (the pose of the one car, a row for each frame). Nothing in
it has a stamp: frame N is stamped 0.1 s times N after September 9, 2001.

The calibration is `geometry.yaml` (for each camera `w2c`, 4 x 4, world to camera frame, and `c2p`, 3 x 4, camera frame
to pixels) or `calib.txt` (29 numbers a row: the camera's number, 16 of the world to its body frame, x forward, y left,
z up, and 12 of `c2p`). The world is taken to be the frame of the combined cloud, `point_cloud`.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from mcap.writer import Writer

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.rig.calibration import decompose_projection

START_NS, STEP_NS = 1_000_000_000 * 10**9, 100_000_000
SITE, CLOUD_TOPIC, TRUTH_TOPIC = "point_cloud", "/point_cloud_combined", "/ground_truth/objects"
CAMERAS = (11, 12, 13, 14, 41, 42, 43, 44)
CAR_SIZE_M, CAR_CENTER_Z_M = (0.33, 0.22, 0.21), 0.112

# x, y, z, 1 in the body frame to -y, -z, x, x, to which `c2p` of calib.txt is applied.
OPTICAL_BODY = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [1, 0, 0, 0]], np.float64)


def projections(path: Path) -> dict[int, Any]:
    """(3, 4) projection of the world to pixels, by number of the camera."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".txt":
        rows = np.loadtxt(text.splitlines(), np.float64, ndmin=2)
        if rows.shape[1] != 29:
            raise SystemExit(f"{path}: expected 29 numbers a row, found {rows.shape[1]}")
        return {int(row[0]): row[17:].reshape(3, 4) @ OPTICAL_BODY @ row[1:17].reshape(4, 4) for row in rows}
    tree = yaml.safe_load(text)
    found = {}
    for name, camera in tree.get("cameras", tree).items():
        number = re.search(r"\d+$", str(name))
        if number is None or not isinstance(camera, dict) or "c2p" not in camera:
            raise SystemExit(f"{path}: {name}: expected a camera with a number in its name, w2c and c2p")
        c2p, w2c = np.array(camera["c2p"], np.float64), np.array(camera["w2c"], np.float64)
        found[int(number[0])] = c2p.reshape(3, 4) @ w2c.reshape(4, 4)
    return found


def true_cars(path: Path) -> list[tuple[Any, Any, Any]]:
    """Position, quaternion (x, y, z, w) and size of the car in each frame.

    The format of a row was never published; its number of columns says what it holds: 3 are x, y, yaw; 4 are x, y, z,
    yaw; 7 are position and quaternion or, if the last four are none, position, size and yaw; 13 are a pose and its
    velocities. Metres and radians.
    """
    rows = np.loadtxt(path.read_text(encoding="utf-8").replace(",", " ").splitlines(), np.float64, ndmin=2)
    columns = rows.shape[1]
    if columns not in (3, 4, 7, 13) or not np.isfinite(rows).all():
        raise SystemExit(f"{path}: expected rows of 3, 4, 7 or 13 finite numbers, found {columns}")
    has_quaternion = columns >= 7 and bool((abs(np.linalg.norm(rows[:, 3:7], axis=1) - 1) < 0.01).all())
    if columns == 13 and not has_quaternion:
        raise SystemExit(f"{path}: expected a quaternion in columns 4 to 7 of 13, found other numbers")
    found = []
    for row in rows:
        position = row[:3] if columns > 3 else (*row[:2], CAR_CENTER_Z_M)
        turn = row[3:7] if has_quaternion else (0.0, 0.0, np.sin(row[-1] / 2), np.cos(row[-1] / 2))
        found.append((position, turn, row[3:6] if columns == 7 and not has_quaternion else CAR_SIZE_M))
    return found


def numbers(folder: Path, suffix: str) -> set[int]:
    """The numbers that name files or folders."""
    return {int(path.stem) for path in folder.glob(f"*{suffix}") if path.stem.isdecimal()}


def frames_of(folder: Path) -> Iterator[tuple[int, str, Any]]:
    """Stamp, topic and message of everything in the folder, frame by frame."""
    frames = sorted(numbers(folder / "pcd", ".txt"))
    odometry = sorted(numbers(folder / "odom", ".txt"))
    if not frames or not odometry:
        raise SystemExit(f"{folder}: expected clouds pcd/0.txt, pcd/1.txt, ... and odometry odom/30000.txt")
    cars = true_cars(folder / "odom" / f"{odometry[-1]}.txt")
    for number in frames:
        stamp_ns = START_NS + number * STEP_NS
        text = (folder / "pcd" / f"{number}.txt").read_text(encoding="utf-8").replace(",", " ")
        points = np.loadtxt(text.splitlines(), np.float32, ndmin=2).reshape(-1, 4)
        columns = dict(zip(("x", "y", "z", "intensity"), np.ascontiguousarray(points.T), strict=True))
        yield stamp_ns, CLOUD_TOPIC, ROS2.cloud(stamp_ns, SITE, columns)
        for row, camera in enumerate(CAMERAS):
            path = folder / "img" / str(number) / f"{row}.jpg"
            if path.is_file():
                jpeg = np.frombuffer(path.read_bytes(), np.uint8)
                message = ROS2.compressed_image(stamp_ns, f"cam{camera}", "jpeg", jpeg)
                yield stamp_ns, f"/image_raw_{camera}/compressed", message
        if number < len(cars):
            yield stamp_ns, TRUTH_TOPIC, truth_message(stamp_ns, *cars[number])


def truth_message(stamp_ns: int, position: Any, quaternion: Any, size_m: Any) -> Any:
    """vision_msgs/Detection3DArray of the car."""
    header, pose = ROS2.header(stamp_ns, SITE), ROS2.pose(map(float, position), map(float, quaternion))
    box = ROS2.new("vision_msgs/msg/BoundingBox3D", pose, ROS2.vector(*map(float, size_m)))
    hypothesis = ROS2.new("vision_msgs/msg/ObjectHypothesis", "car", 1.0)
    result = ROS2.new("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis, ROS2.pose_with_covariance(pose))
    car = ROS2.new("vision_msgs/msg/Detection3D", header=header, results=[result], bbox=box, id="0")
    return ROS2.new("vision_msgs/msg/Detection3DArray", header, [car])


def calibration_messages(path: Path, sizes_px: dict[int, tuple[int, int]]) -> Iterator[tuple[str, Any]]:
    """Topic and message of the calibration of the cameras with images, /tf_static last."""
    transforms = []
    for camera, projection in projections(path).items():
        if camera not in sizes_px:
            continue
        try:
            K, T_camera_site = decompose_projection(f"camera {camera}", projection)
        except CalibrationError as err:
            print(f"left out: {err}", file=sys.stderr)
            continue
        width, height = sizes_px[camera]
        lens: dict[str, Any] = {"distortion_model": "plumb_bob", "d": np.zeros(5), "k": K.reshape(9)}
        yield f"/camera_info_{camera}", ROS2.camera_info(START_NS, f"cam{camera}", width=width, height=height, **lens)
        transforms.append(Transform(f"cam{camera}", SITE, T_camera_site).inverse())
    yield "/tf_static", ROS2.transforms(START_NS, transforms)


def image_sizes_px(folder: Path) -> dict[int, tuple[int, int]]:
    """Width and height of the first image of each camera."""
    found = {}
    for row, camera in enumerate(CAMERAS):
        path = next((folder / "img").glob(f"*/{row}.jpg"), None)
        image = None if path is None else cv2.imread(str(path))
        if image is not None:
            found[camera] = (image.shape[1], image.shape[0])
    return found


def convert(folder: Path, output: Path, calibration: Path | None) -> None:
    """Write the recording; nothing is left of one that fails."""
    with output.open("xb") as stream, ExitStack() as failed:
        failed.callback(output.unlink)
        writer = Writer(stream)
        writer.start("ros2")
        channels: dict[str, int] = {}

        def write(log_time_ns: int, topic: str, message: Any) -> None:
            if topic not in channels:
                definition = ROS2.definition(message.__msgtype__).encode()
                schema = writer.register_schema(message.__msgtype__, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], log_time_ns, ROS2.serialize(message), log_time_ns)

        if calibration is not None:
            for topic, message in calibration_messages(calibration, image_sizes_px(folder)):
                write(START_NS, topic, message)
        for stamp_ns, topic, message in frames_of(folder):
            write(stamp_ns, topic, message)
        writer.finish()
        failed.pop_all()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--calibration", type=Path, help="geometry.yaml or calib.txt; without it, images are not used")
    options = parser.parse_args()
    try:
        convert(options.folder, options.output, options.calibration)
    except OSError as err:
        raise SystemExit(f"{err.filename}: {err.strerror}") from err
