"""ASAM OpenLABEL 1.0 (asam.net/standards/detail/openlabel): a JSON file of cuboids for each result."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.writers.datasets.frame import DatasetBoxes, DatasetFrame, DatasetScene, write_image

CLOUD = "lidar"
"""Name of the stream of clouds."""

PCD_HEADER = (
    "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n"
    "COUNT 1 1 1 1\nWIDTH {0}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {0}\nDATA binary\n"
)

Tree = dict[str, Any]


class OpenLabelWriter:
    """Writes `labels/RESULT.json`, `results/RESULT.json`, and clouds and images in `data/RESULT/`.

    The labels are the truth where there is one, else the objects; the results always are the objects, with scores.
    """

    names: Mapping[str, str] | None = None
    needs_clouds = False

    def __init__(self, folder: Path) -> None:
        self.left_out, self.remarks = Counter[str](), list[str]()
        self._folder = folder
        self._files: dict[str, _Labels] = {}
        self._scene: DatasetScene | None = None
        self._count = 0

    def begin(self, scene: DatasetScene) -> None:
        """See `DatasetWriter`."""
        self._end_scene()
        self._scene, self._count = scene, 0
        self._files = {"labels": _Labels(has_scores=False), "results": _Labels(has_scores=True)}

    def add(self, frame: DatasetFrame) -> None:
        """See `DatasetWriter`."""
        assert self._scene is not None
        streams: Tree = {}
        if frame.cloud is not None:
            streams[CLOUD] = {"uri": self._new(CLOUD, "pcd", lambda path: _write_pcd(path, frame.cloud))}
        for name, image in frame.images.items():
            uri = self._new(name, "jpg", lambda path, rgb=image.rgb: write_image(path, rgb))
            sync = {"timestamp": str(image.stamp_ns)}
            streams[name] = {"uri": uri, "stream_properties": {"sync": sync}}
        properties = {"timestamp": frame.stamp_ns, "streams": streams}
        boxes = {"labels": frame.objects if frame.truth is None else frame.truth, "results": frame.objects}
        for name, labels in self._files.items():
            labels.add(self._count, properties, boxes[name], self._scene.rig.site_frame)
        self._count += 1

    def finish(self) -> None:
        """See `DatasetWriter`."""
        self._end_scene()

    def _new(self, stream: str, ending: str, write: Any) -> str:
        """Write a file of the current frame; its path from the folder of labels."""
        assert self._scene is not None
        name = Path("data") / self._scene.name / stream / f"{self._count:06d}.{ending}"
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path)
        return f"../{name}"

    def _end_scene(self) -> None:
        if self._scene is None:
            return
        for name, labels in self._files.items():
            path = self._folder / name / f"{self._scene.name}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(labels.tree(self._scene), allow_nan=False), encoding="utf-8")


class _Labels:
    """The content of a file, while it is gathered."""

    def __init__(self, *, has_scores: bool) -> None:
        self._has_scores = has_scores
        self._frames: dict[str, Tree] = {}
        self._objects: dict[str, Tree] = {}
        self._keys: dict[tuple[int, str], str] = {}
        self._lone = 0

    def add(self, number: int, properties: Tree, boxes: DatasetBoxes, frame_id: str) -> None:
        """Add a frame."""
        objects: Tree = {}
        for row in range(len(boxes)):
            key = self._key(int(boxes.tracks[row]), str(boxes.names[row]))
            yaw = float(boxes.yaws[row])
            turn = [0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))]
            numbers = [{"name": "num_points", "val": int(boxes.point_counts[row])}] * bool(boxes.point_counts[row] >= 0)
            if self._has_scores:
                numbers.append({"name": "score", "val": float(boxes.scores[row])})
            cuboid: Tree = {
                "name": "shape3D",
                "val": [*boxes.centers[row].tolist(), *turn, *boxes.sizes[row].tolist()],
                "coordinate_system": frame_id,
            }
            objects[key] = {"object_data": {"cuboid": [cuboid | ({"attributes": {"num": numbers}} if numbers else {})]}}
            self._objects[key].setdefault("frame_intervals", []).append({"frame_start": number, "frame_end": number})
        self._frames[str(number)] = {"frame_properties": properties, "objects": objects}

    def tree(self, scene: DatasetScene) -> Tree:
        """All of it."""
        site, sensors = scene.rig.site_frame, {}
        if scene.cloud_frame_id != site:
            sensors[scene.cloud_frame_id] = scene.T_site_cloud
        sensors |= {camera.name: camera.T_camera_site.inverse().matrix for camera in scene.cameras}
        systems = {site: {"type": "local_cs", "parent": "", "children": [*sensors]}}
        systems |= {name: _system(site, pose) for name, pose in sensors.items()}
        streams = {CLOUD: {"type": "lidar", "description": f"in the coordinate system {scene.cloud_frame_id}"}}
        for camera in scene.cameras:
            intrinsics = {
                "camera_matrix_3x4": np.column_stack([camera.model.K, np.zeros(3)]).ravel().tolist(),
                "distortion_coeffs_1xN": [0.0] * 5,
                "height_px": camera.model.height_px,
                "width_px": camera.model.width_px,
            }
            properties = {"intrinsics_pinhole": intrinsics}
            # A dict of dicts is no tree of JSON to mypy, as dict is invariant.
            streams[camera.name] = {"type": "camera", "description": "", "stream_properties": properties}  # type: ignore[dict-item]
        for found in self._objects.values():
            found["frame_intervals"] = _joined(found["frame_intervals"])
        last = len(self._frames) - 1
        return {
            "openlabel": {
                "metadata": {"schema_version": "1.0.0", "name": scene.name, "annotator": "lidcam"},
                "coordinate_systems": systems,
                "streams": streams,
                "objects": self._objects,
                "frames": self._frames,
                "frame_intervals": [{"frame_start": 0, "frame_end": last}] if self._frames else [],
            }
        }

    def _key(self, track: int, name: str) -> str:
        """The key of an object: its track; a new one below 0 for what has none, and where a track changes its class."""
        key = self._keys.get((track, name), "") if track >= 0 else ""
        if not key and track >= 0 and str(track) not in self._objects:
            key = str(track)
        if not key:
            self._lone += 1
            key = str(-self._lone)
        if track >= 0:
            self._keys[track, name] = key
        self._objects.setdefault(key, {"name": f"{name} {key}", "type": name})
        return key


def _system(parent: str, T_parent_system: F64) -> Tree:
    pose = {"matrix4x4": T_parent_system.ravel().tolist()}
    return {"type": "sensor_cs", "parent": parent, "children": [], "pose_wrt_parent": pose}


def _joined(intervals: list[dict[str, int]]) -> list[dict[str, int]]:
    """Intervals of one frame each, joined where one follows another."""
    joined: list[dict[str, int]] = []
    for one in intervals:
        if joined and joined[-1]["frame_end"] >= one["frame_start"] - 1:
            joined[-1] = {**joined[-1], "frame_end": one["frame_end"]}
        else:
            joined.append(one)
    return joined


def _write_pcd(path: Path, cloud: PointCloud | None) -> None:
    assert cloud is not None
    points = np.column_stack([cloud.xyz, cloud.intensity]).astype("<f4")
    path.write_bytes(PCD_HEADER.format(len(points)).encode() + points.tobytes())
