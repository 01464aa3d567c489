"""nuScenes's tables of version 1.0, and a submission of detections (github.com/nutonomy/nuscenes-devkit, docs).

Every frame is a sample, and all its data are key frames. The global frame is the one that does not move, the ego frame
is the site frame. Tokens are hashes of what they name, so that the same results give the same bytes.
"""

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F64, I32
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.core.geometry.rotations import pose_matrix, quaternion_of_matrix
from lidcam.writers.datasets.frame import DatasetBoxes, DatasetFrame, DatasetScene, DatasetWriter, write_image

VERSION = "v1.0-lidcam"
"""Name of the folder of tables, which the devkit is given."""

CATEGORIES = {
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "trailer": "vehicle.trailer",
    "construction_vehicle": "vehicle.construction",
    "pedestrian": "human.pedestrian.adult",
    "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "traffic_cone": "movable_object.trafficcone",
    "barrier": "movable_object.barrier",
}
"""Category by name of the detection challenge."""

NUSCENES_NAMES: Mapping[str, str] = {**{name: name for name in CATEGORIES}, "person": "pedestrian"}

TABLES = (
    *("attribute", "calibrated_sensor", "category", "ego_pose", "instance", "log", "map"),
    *("sample", "sample_annotation", "sample_data", "scene", "sensor", "visibility"),
)

LIDAR = "LIDAR_TOP"
MAX_BOXES = 500
"""Maximum number of boxes of a sample in a submission."""

Row = dict[str, Any]


class NuScenesWriter(DatasetWriter):
    """Writes the tables, `samples/`, and `results.json`: the objects as a submission of detections.

    `sample_annotation` has the truth where there is one, else the objects. `splits.json` calls all scenes `lidcam`.
    """

    names: Mapping[str, str] = NUSCENES_NAMES

    def __init__(self, folder: Path, camera: str = "") -> None:
        super().__init__(folder, camera)
        self._tables: dict[str, list[Row]] = {name: [] for name in TABLES}
        self._results: dict[str, list[Row]] = {}
        self._scene: DatasetScene
        self._samples: list[str] = []
        self._last: dict[str, Row] = {}  # by chain
        self._instances: dict[str, Row] = {}
        self._calibrations: dict[str, str] = {}
        self._lone = 0
        for name, category in CATEGORIES.items():
            self._put("category", name, of_scene=False, name=category, description="")

    def begin(self, scene: DatasetScene) -> None:
        """See `DatasetWriter`."""
        self._end_scene()
        self._scene, self._samples, self._last, self._instances, self._lone = scene, [], {}, {}, 0
        site, channels = scene.rig.site_frame, [_channel(camera.name) for camera in scene.cameras]
        if twice := next((one for one in channels if channels.count(one) > 1), None):
            raise OutputError(f"{scene.name}: two cameras would both be {twice}: rename one in the rig file")
        self._calibrations = {LIDAR: self._calibrated(LIDAR, "lidar", scene.T_site_cloud, [])}
        for camera in scene.cameras:
            T_site_camera = camera.T_camera_site.inverse().matrix
            channel = _channel(camera.name)
            self._calibrations[channel] = self._calibrated(channel, "camera", T_site_camera, camera.model.K.tolist())
        self._put("log", logfile=scene.name, vehicle=site, date_captured="", location=scene.name)

    def add_frame(self, frame: DatasetFrame) -> None:
        """See `DatasetWriter`; a frame without a cloud, or whose place nobody knows, is left out."""
        if frame.T_fixed_site is None or frame.cloud is None:
            lacking = "a cloud" if frame.cloud is None else "a known place of the site frame"
            self.left_out[f"frames without {lacking}"] += 1
            return
        number, cloud = len(self._samples), frame.cloud
        times: Row = {"timestamp": frame.stamp_ns // 1000, "scene_token": self._token("scene")}
        self._samples.append(str(self._put("sample", frame.index, chain="sample", **times)["token"]))
        path = self._sample_file(LIDAR, f"{number:06d}.pcd.bin")
        points = np.column_stack([cloud.xyz, cloud.intensity * 255, cloud.ring])
        (self._folder / path).write_bytes(points.astype("<f4").tobytes())
        self._put_data(LIDAR, frame.index, path, frame.stamp_ns, frame.T_fixed_site, "pcd", (0, 0))
        for name, image in frame.images.items():
            if image.T_fixed_site is None:
                self.left_out["images without a known place of the site frame"] += 1
                continue
            channel = _channel(name)
            path = self._sample_file(channel, f"{number:06d}.jpg")
            write_image(self._folder / path, image.rgb)
            self._put_data(channel, frame.index, path, image.stamp_ns, image.T_fixed_site, "jpg", image.rgb.shape)
            self.written["images"] += 1
        boxes = frame.objects if frame.truth is None else frame.truth
        self._put_annotations(frame, boxes, frame.T_fixed_site)
        self.written.update(frames=1, boxes=len(boxes))
        self._put_results(self._samples[-1], frame.objects, frame.T_fixed_site)

    def finish(self) -> None:
        """See `DatasetWriter`."""
        self._end_scene()
        logs = [log["token"] for log in self._tables["log"]]
        self._put("map", of_scene=False, log_tokens=logs, category="semantic_prior", filename="maps/none.png")
        cv2.imwrite(str(self._file("maps/none.png")), np.zeros((1, 1), np.uint8))
        splits = {"lidcam": [scene["name"] for scene in self._tables["scene"]]}
        for name, rows in (*self._tables.items(), ("splits", splits)):
            _write_json(self._file(VERSION, f"{name}.json"), rows)
        used = {"use_camera": True, "use_lidar": True, "use_radar": False, "use_map": False, "use_external": False}
        _write_json(self._file("results.json"), {"meta": used, "results": self._results})

    def _token(self, table: str, *key: object) -> str:
        return _token(self._scene.origin, table, *key)

    def _put(self, table: str, *key: object, of_scene: bool = True, chain: str = "", **values: Any) -> Row:
        """A new row of a table, with a key in the scene, or in all; rows of a chain of a scene point to one another."""
        row = {"token": self._token(table, *key) if of_scene else _token(table, *key), **values}
        if chain:
            last = self._last.get(chain)
            row |= {"prev": last["token"] if last else "", "next": ""}
            if last:
                last["next"] = row["token"]
            self._last[chain] = row
        self._tables[table].append(row)
        return row

    def _calibrated(self, channel: str, modality: str, T_site_sensor: F64, intrinsic: list[list[float]]) -> str:
        if channel not in {sensor["channel"] for sensor in self._tables["sensor"]}:
            self._put("sensor", channel, of_scene=False, channel=channel, modality=modality)
        facts: Row = {"sensor_token": _token("sensor", channel), **_pose(T_site_sensor), "camera_intrinsic": intrinsic}
        return str(self._put("calibrated_sensor", channel, **facts)["token"])

    def _sample_file(self, channel: str, name: str) -> str:
        """The path in the data set of a file, whose folder is made."""
        path = self._file("samples", channel, f"{self._scene.name}__{channel}__{name}")
        return str(path.relative_to(self._folder))

    def _put_data(
        self, channel: str, index: int, path: str, stamp_ns: int, T_fixed_site: F64, kind: str, size: Sequence[int]
    ) -> None:
        stamp_us = stamp_ns // 1000
        pose = self._put("ego_pose", channel, index, timestamp=stamp_us, **_pose(T_fixed_site))
        self._put(
            "sample_data",
            channel,
            index,
            chain=channel,
            sample_token=self._token("sample", index),
            ego_pose_token=pose["token"],
            calibrated_sensor_token=self._calibrations[channel],
            timestamp=stamp_us,
            fileformat=kind,
            is_key_frame=True,
            height=size[0],
            width=size[1],
            filename=path,
        )

    def _put_annotations(self, frame: DatasetFrame, boxes: DatasetBoxes, T_fixed_site: F64) -> None:
        counts = self._points(frame, boxes)
        for row, placed in enumerate(_placed(boxes, T_fixed_site)):
            name, track = str(boxes.names[row]), int(boxes.tracks[row])
            if track < 0:
                self._lone += 1
            # one instance has one category: where a track changes its class, another one begins
            key = f"{track} {name}" if track >= 0 else f"lone {self._lone}"
            token = self._token("sample_annotation", frame.index, row)
            instance = self._instances.get(key)
            if instance is None:
                instance = self._instances[key] = self._put(
                    "instance",
                    key,
                    category_token=_token("category", name),
                    nbr_annotations=0,
                    first_annotation_token=token,
                    last_annotation_token="",
                )
            self._put(
                "sample_annotation",
                frame.index,
                row,
                chain=instance["token"],
                sample_token=self._token("sample", frame.index),
                instance_token=instance["token"],
                visibility_token="",
                attribute_tokens=[],
                **placed,
                num_lidar_pts=int(counts[row]),
                num_radar_pts=0,
            )
            instance["nbr_annotations"] += 1
            instance["last_annotation_token"] = token

    def _points(self, frame: DatasetFrame, boxes: DatasetBoxes) -> I32:
        """Points in each box: as they were counted, else those of the cloud."""
        counts = boxes.point_counts.copy()
        if (counts >= 0).all() or frame.cloud is None:
            return counts
        T_site_cloud = self._scene.T_site_cloud
        xyz = frame.cloud.xyz @ T_site_cloud[:3, :3].T + T_site_cloud[:3, 3]
        for row in np.flatnonzero(counts < 0):
            cos, sin = np.cos(boxes.yaws[row]), np.sin(boxes.yaws[row])
            inside = (xyz - boxes.centers[row]) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
            counts[row] = (np.abs(inside) <= boxes.sizes[row] / 2).all(1).sum()
        return counts

    def _put_results(self, sample: str, boxes: DatasetBoxes, T_fixed_site: F64) -> None:
        if (more := len(boxes) - MAX_BOXES) > 0:
            self.left_out[f"objects beyond {MAX_BOXES} in a sample, those with the lowest scores"] += more
            boxes = boxes.select(np.sort(np.argsort(-boxes.scores, kind="stable")[:MAX_BOXES]))
        velocities = np.nan_to_num(boxes.velocities) @ T_fixed_site[:2, :2].T
        self._results[sample] = [
            {
                "sample_token": sample,
                **placed,
                "velocity": velocities[row].tolist(),
                "detection_name": str(boxes.names[row]),
                "detection_score": float(boxes.scores[row]),
                "attribute_name": "",
            }
            for row, placed in enumerate(_placed(boxes, T_fixed_site))
        ]

    def _end_scene(self) -> None:
        if self._samples:
            scene = self._scene
            self._put(
                "scene",
                name=scene.name,
                description="",
                log_token=self._token("log"),
                nbr_samples=len(self._samples),
                first_sample_token=self._samples[0],
                last_sample_token=self._samples[-1],
            )
        self._samples = []


def _channel(camera: str) -> str:
    return camera if camera.upper().startswith("CAM_") else f"CAM_{camera}"


def _token(*what: object) -> str:
    return sha256("\n".join(map(str, what)).encode()).hexdigest()[:32]


def _pose(T_dst_src: F64) -> Row:
    x, y, z, w = quaternion_of_matrix(T_dst_src[:3, :3]).tolist()
    return {"translation": T_dst_src[:3, 3].tolist(), "rotation": [w, x, y, z]}


def _placed(boxes: DatasetBoxes, T_fixed_site: F64) -> list[Row]:
    """Boxes in the fixed frame; sizes are width, length, height."""
    poses = pose_matrix(np.tile(np.eye(3), (len(boxes), 1, 1)), boxes.centers)
    poses[:, :2, :2] = rotations_2d(boxes.yaws)
    sizes = boxes.sizes[:, [1, 0, 2]].tolist()
    return [_pose(T_fixed_site @ pose) | {"size": size} for pose, size in zip(poses, sizes, strict=True)]


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, allow_nan=False), encoding="utf-8")
