"""Clouds and cuboids for CVAT (docs.cvat.ai): a task's data in Supervisely's layout, boxes as Datumaro's JSON.

Clouds are in the site frame, which is level, so that boxes turn about z alone.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F32
from lidcam.writers.datasets.frame import DatasetFrame, DatasetScene, DatasetWriter, write_image

POINT_CLOUD_MEDIA = 6
"""Datumaro's number of a data set of clouds."""

IN_TRACK = {"keyframe": True, "outside": False, "occluded": False}
"""Attributes of a box of a track."""


class CvatWriter(DatasetWriter):
    """Writes `pointcloud/`, `related_images/`, `labels.json` and `annotations/default.json`.

    Boxes are the truth where there is one, else what lidcam found. Those of a track and one class become a track
    with a key frame in each frame: what CVAT takes for a track has these attributes.
    """

    names: Mapping[str, str] = {}

    def __init__(self, folder: Path, camera: str = "") -> None:
        super().__init__(folder, camera)
        self._items, self._labels = list[Any](), list[str]()
        self._tracks = dict[tuple[str, int, str], int]()
        self._scene: DatasetScene

    def begin(self, scene: DatasetScene) -> None:
        """See `DatasetWriter`."""
        self._scene = scene

    def add_frame(self, frame: DatasetFrame) -> None:
        """See `DatasetWriter`; a frame without a cloud is left out."""
        if frame.cloud is None:
            self.left_out["frames without a cloud"] += 1
            return
        name, T = f"{self._scene.name}_{frame.index:06d}", self._scene.T_site_cloud
        points = np.column_stack([frame.cloud.xyz @ T[:3, :3].T + T[:3, 3], frame.cloud.intensity])
        self._file("pointcloud", f"{name}.pcd").write_bytes(pcd(points.astype(np.float32)))
        for camera, image in frame.images.items():
            write_image(self._file("related_images", f"{name}_pcd", f"{camera}.jpg"), image.rgb)
        boxes = self._boxes(frame)
        media = {"point_cloud": {"path": f"{name}.pcd"}}
        self._items.append({"id": name, "annotations": boxes, "attr": {"frame": len(self._items)}} | media)
        self.written.update(frames=1, images=len(frame.images), boxes=len(boxes))

    def finish(self) -> None:
        """See `DatasetWriter`."""
        labels = [{"name": name, "parent": "", "attributes": []} for name in self._labels]
        whole = {
            "dm_format_version": "1.0",
            "media_type": POINT_CLOUD_MEDIA,
            "infos": {},
            "categories": {"label": {"labels": labels, "label_groups": [], "attributes": []}},
            "items": self._items,
        }
        self._file("annotations", "default.json").write_text(json.dumps(whole, allow_nan=False))
        of_task = [{"name": name, "attributes": []} for name in self._labels]
        self._file("labels.json").write_text(json.dumps(of_task))

    def _boxes(self, frame: DatasetFrame) -> list[dict[str, Any]]:
        boxes = frame.objects if frame.truth is None else frame.truth
        self._labels += [name for name in dict.fromkeys(boxes.names.tolist()) if name not in self._labels]
        return [
            {
                "id": row,
                "type": "cuboid_3d",
                "attributes": {"track_id": self._track(track, name), **IN_TRACK} if track >= 0 else {},
                "group": 0,
                "label_id": self._labels.index(name),
                "position": boxes.centers[row].round(4).tolist(),
                "rotation": [0.0, 0.0, round(float(boxes.yaws[row]), 5)],
                "scale": boxes.sizes[row].round(4).tolist(),
            }
            for row, (name, track) in enumerate(zip(boxes.names.tolist(), boxes.tracks.tolist(), strict=True))
        ]

    def _track(self, track: int, name: str) -> int:
        """The number of a track of the scene and of one class, from 0 over all scenes."""
        return self._tracks.setdefault((self._scene.name, track, name), len(self._tracks))


def pcd(points: F32) -> bytes:
    """A file of the Point Cloud Library, binary; (N, 4) x, y, z in metres and intensity."""
    lines = ["VERSION .7", "FIELDS x y z intensity", "SIZE 4 4 4 4", "TYPE F F F F", "COUNT 1 1 1 1"]
    lines += [f"WIDTH {len(points)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(points)}", "DATA binary"]
    return "".join(f"{line}\n" for line in lines).encode() + points.astype("<f4").tobytes()
