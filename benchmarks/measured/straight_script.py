"""What a user would write instead of lidcam: one script, top to bottom, on the same libraries.

    python benchmarks/measured/straight_script.py IN OUT.mcap [--model yolox.onnx] [--ground 0.2] [--link 0.7]

rosbags reads the whole recording; each cloud of the first lidar gets the nearest message of every other topic; Open3D
removes outliers (11 neighbours with the point itself, 0.2 standard deviations) and the ground, and links points to
clusters; YOLOX by onnxruntime looks at every image; a cluster whose box overlaps a 2D box in an image is an object. A
JSON message of objects and the points go into an MCAP for each frame. No motion, no damage, no missing sensors: it is
here for its speed alone, which it prints as JSON, from the loading of the network to the last byte written.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from lidcam.bags.simulator.world.open3d_runtime import load_open3d

o3d = load_open3d()

Stored = dict[str, list[tuple[int, Any]]]

SIDE_PX, PADDING = 416, 114
MIN_SCORE, MAX_OVERLAP, MIN_IOU = 0.3, 0.45, 0.3
MIN_POINTS, VOXEL_M = 10, 0.1
POINT_TYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}

spent_s: defaultdict[str, float] = defaultdict(float)


@contextmanager
def timed(step: str) -> Iterator[None]:
    """Add the time within to the step's."""
    start = time.perf_counter()
    yield
    spent_s[step] += time.perf_counter() - start


def matrix_of(transform: Any) -> Any:
    """The 4 x 4 matrix of a geometry_msgs/Transform."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat([getattr(transform.rotation, name) for name in "xyzw"]).as_matrix()
    matrix[:3, 3] = [getattr(transform.translation, name) for name in "xyz"]
    return matrix


def read(path: Path) -> tuple[Stored, Stored, dict[str, Any], dict[str, tuple[str, Any]]]:
    """Clouds and images by topic, camera matrices by frame, transforms by child frame."""
    clouds: Stored = defaultdict(list)
    images: Stored = defaultdict(list)
    cameras, transforms = {}, {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            kind = connection.msgtype.split("/")[-1]
            if kind not in {"PointCloud2", "Image", "CompressedImage", "CameraInfo", "TFMessage"}:
                continue
            message: Any = reader.deserialize(raw, connection.msgtype)
            if kind == "TFMessage":
                for one in message.transforms:
                    transforms[one.child_frame_id] = one.header.frame_id, matrix_of(one.transform)
            elif kind == "CameraInfo":
                values = message.K if hasattr(message, "K") else message.k
                cameras[message.header.frame_id] = np.reshape(values, (3, 3))
            else:
                stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                (clouds if kind == "PointCloud2" else images)[connection.topic].append((stamp_ns, message))
    return dict(sorted(clouds.items())), dict(sorted(images.items())), cameras, transforms


def to_root(frame: str, transforms: dict[str, tuple[str, Any]]) -> Any:
    """The matrix from a frame to the root of its tree."""
    matrix = np.eye(4)
    while frame in transforms:
        frame, step = transforms[frame]
        matrix = step @ matrix
    return matrix


def points_of(message: Any) -> Any:
    """(N, 3) finite points of a PointCloud2."""
    layout = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [POINT_TYPES[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    found = np.frombuffer(message.data, layout)
    points = np.stack([found["x"], found["y"], found["z"]], 1).astype(np.float64)
    return points[np.isfinite(points).all(1)]


def image_of(message: Any) -> Any:
    """(H, W, 3) of an Image or CompressedImage, blue first."""
    if hasattr(message, "format"):
        return cv2.imdecode(message.data, cv2.IMREAD_COLOR)
    rows = message.data.reshape(message.height, message.step)[:, : message.width * 3]
    pixels = rows.reshape(message.height, message.width, 3)
    return np.ascontiguousarray(pixels[..., ::-1] if message.encoding == "rgb8" else pixels)


class Yolox:
    """YOLOX with its three grids."""

    def __init__(self, path: Path) -> None:
        self._session = onnxruntime.InferenceSession(path)
        self._input = self._session.get_inputs()[0].name
        cells, steps = [], []
        for step in (8, 16, 32):
            count = SIDE_PX // step
            y, x = np.mgrid[:count, :count]
            cells.append(np.stack([x, y], 2).reshape(-1, 2))
            steps.append(np.full((count * count, 1), step))
        self._cells, self._steps = np.concatenate(cells), np.concatenate(steps)

    def __call__(self, image: Any) -> tuple[Any, Any]:
        """(M, 4) boxes in pixels and (M,) their classes."""
        scale = min(SIDE_PX / image.shape[0], SIDE_PX / image.shape[1])
        width, height = int(image.shape[1] * scale), int(image.shape[0] * scale)
        padded = np.full((SIDE_PX, SIDE_PX, 3), PADDING, np.uint8)
        padded[:height, :width] = cv2.resize(image, (width, height))
        (found,) = self._session.run(None, {self._input: padded.transpose(2, 0, 1)[None].astype(np.float32)})[0]
        centers = (found[:, :2] + self._cells) * self._steps
        sizes = np.exp(found[:, 2:4]) * self._steps
        scores = found[:, 4:5] * found[:, 5:]
        best = scores.max(1)
        likely = best > MIN_SCORE
        corners = (centers - sizes / 2)[likely] / scale
        extents = sizes[likely] / scale
        rows = cv2.dnn.NMSBoxes(np.hstack([corners, extents]).tolist(), best[likely].tolist(), MIN_SCORE, MAX_OVERLAP)
        kept = np.asarray(rows, np.intp).reshape(-1)
        return np.hstack([corners, corners + extents])[kept], scores.argmax(1)[likely][kept]


def iou(first: Any, second: Any) -> float:
    """Overlap of two rectangles."""
    width = min(first[2], second[2]) - max(first[0], second[0])
    height = min(first[3], second[3]) - max(first[1], second[1])
    shared = max(0.0, width) * max(0.0, height)
    areas = [(one[2] - one[0]) * (one[3] - one[1]) for one in (first, second)]
    return float(shared / (sum(areas) - shared + 1e-9))


def boxes_of(cloud: Any, link_m: float) -> list[tuple[Any, Any]]:
    """Lowest and highest corner of each cluster."""
    thinned = cloud.voxel_down_sample(VOXEL_M) if link_m > 3 * VOXEL_M else cloud
    labels, points = np.array(thinned.cluster_dbscan(link_m, MIN_POINTS)), np.asarray(thinned.points)
    rows = (labels == label for label in range(labels.max(initial=-1) + 1))
    return [(points[row].min(0), points[row].max(0)) for row in rows]


def projected(low: Any, high: Any, camera: Any, to_camera: Any) -> list[float] | None:
    """The rectangle around a box in the image; None if part of it is behind the camera."""
    corners = np.array([[x, y, z, 1] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    seen = corners @ to_camera[:3].T
    if (seen[:, 2] < 0.1).any():
        return None
    pixels = seen @ camera.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    return [*pixels.min(0), *pixels.max(0)]


def main() -> None:
    """Process a recording and print the speed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--ground", type=float, default=0.2)
    parser.add_argument("--link", type=float, default=0.7)
    options = parser.parse_args()
    began_s = time.perf_counter()
    network = Yolox(options.model) if options.model else None
    with timed("read"):
        clouds, images, cameras, transforms = read(options.recording)
    reference = next(iter(clouds.values()))
    with options.out.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("", "straight script")
        schema = writer.register_schema("objects", "jsonschema", b'{"type":"object"}')
        found_channel = writer.register_channel("/objects", "json", schema)
        cloud_channel = writer.register_channel("/cloud", "raw", 0)
        for stamp_ns, _ in reference:
            stored = (clouds | images).items()
            nearest = {topic: min(found, key=lambda one: abs(one[0] - stamp_ns))[1] for topic, found in stored}
            with timed("decode clouds"):
                parts = []
                for topic in clouds:
                    matrix = to_root(nearest[topic].header.frame_id, transforms)
                    parts.append(points_of(nearest[topic]) @ matrix[:3, :3].T + matrix[:3, 3])
                cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.concatenate(parts)))
            with timed("outliers"):
                cloud, _ = cloud.remove_statistical_outlier(11, 0.2)
            with timed("ground"):
                o3d.utility.random.seed(0)
                _, plane = cloud.segment_plane(options.ground, 3, 1000)
                cloud = cloud.select_by_index(plane, invert=True)
            with timed("clusters"):
                boxes = boxes_of(cloud, options.link)
            objects = []
            for topic in images if network else ():
                message = nearest[topic]
                with timed("decode images"):
                    image = image_of(message)
                with timed("detect 2D"):
                    assert network is not None
                    rectangles, classes = network(image)
                camera = cameras.get(message.header.frame_id)
                if camera is None:
                    continue
                with timed("associate"):
                    to_camera = np.linalg.inv(to_root(message.header.frame_id, transforms))
                    for row, (low, high) in enumerate(boxes):
                        seen = projected(low, high, camera, to_camera)
                        overlaps = [iou(seen, one) for one in rectangles] if seen else []
                        if overlaps and max(overlaps) > MIN_IOU:
                            objects.append((row, int(classes[int(np.argmax(overlaps))])))
            with timed("write"):
                tree = [{"low": [*boxes[row][0]], "high": [*boxes[row][1]], "class": kind} for row, kind in objects]
                writer.add_message(found_channel, stamp_ns, json.dumps(tree).encode(), stamp_ns)
                writer.add_message(cloud_channel, stamp_ns, np.asarray(cloud.points, np.float32).tobytes(), stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # of mcap
    frames, spent_ms = len(reference), {step: 1e3 * seconds / len(reference) for step, seconds in spent_s.items()}
    speed = frames / (time.perf_counter() - began_s)
    print(json.dumps({"timing": {"frames": frames, "frames_per_second": speed, "stage_ms": spent_ms}}))


if __name__ == "__main__":
    main()
