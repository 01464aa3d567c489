"""Data sets of images with 2D boxes: COCO (cocodataset.org/#format-data), and YOLO as Ultralytics reads it.

Images are the recorded ones, with the distortion of the lens. Pixel (0, 0) is the top left corner of the top left
pixel in both formats, as in lidcam.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import yaml

from lidcam.pipeline.core.arrays import F32, I64, CheckedTable, Names
from lidcam.writers.datasets.frame import FolderWriter

VAL_SHARE = 0.2
"""Share of each recording's frames, at its end, that is for validation: images side by side are too alike to be shared
out one by one."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageLabels(CheckedTable):
    """N boxes in an image."""

    ROWS: ClassVar = {"xyxy": (4,)}

    names: Names  # (N,) str, their classes
    xyxy: F32  # (N, 4) float32 left, top, right, bottom in pixels, within the image
    scores: F32  # (N,) float32 in [0, 1]; 1 of true boxes
    tracks: I64  # (N,) int64, the same for the same object in all images of a scene; negative where there is none
    origins: Names  # (N,) str, where each comes from: `both`, `object`, `camera`, `truth`


@dataclass(frozen=True, slots=True, eq=False)
class LabelledImage:
    """One image with its boxes."""

    name: str  # Of its file, without ending; no other image has it
    camera: str  # Its camera
    frame: int  # Number of its frame
    stamp_ns: int  # Its time
    data: bytes  # Its file
    ending: str  # Of the file's name, `.jpg`
    width_px: int  # Its width
    height_px: int  # Its height
    found: ImageLabels  # What lidcam found
    truth: ImageLabels | None  # The true boxes; None if they are not known
    is_late: bool  # Whether it is in the last `VAL_SHARE` of its recording

    @property
    def labels(self) -> ImageLabels:
        """Labels to learn: the truth, else the boxes that lidcam found."""
        return self.found if self.truth is None else self.truth


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """The images of one frame."""

    stamp_ns: int  # Its time
    images: tuple[LabelledImage, ...]  # Those of its cameras


class ImageWriter(FolderWriter, ABC):
    """Writes labelled images."""

    def __init__(self, folder: Path, camera: str = "") -> None:
        super().__init__(folder, camera)
        self._numbers, self._scenes, self._tracks = dict[str, int](), 0, dict[tuple[int, int], int]()

    def begin(self, class_names: Sequence[str]) -> None:
        """Begin a result, whose classes are these; they are numbered in the order in which results name them."""
        self._scenes += 1
        for name in class_names:
            self._numbers.setdefault(name, len(self._numbers))

    def add_frame(self, frame: LabelledFrame) -> None:
        """Write the images of the next frame."""
        for image in frame.images:
            self._add_image(image)
            self.written.update(images=1, boxes=len(image.labels))
        self.written["frames"] += bool(frame.images)

    @abstractmethod
    def finish(self) -> None:
        """Write what stands behind all images."""

    @abstractmethod
    def _add_image(self, image: LabelledImage) -> None:
        """Write an image and its boxes."""

    def _write(self, path: str, data: bytes, *, is_new: bool = False) -> None:
        # Two cameras or results may give two images one name.
        with self._file(path).open("xb" if is_new else "wb") as file:
            file.write(data)


class CocoWriter(ImageWriter):
    """Writes `images/`, `annotations/instances.json`, and `results.json`: what lidcam found, scored, for COCO's kit."""

    def __init__(self, folder: Path, camera: str = "") -> None:
        super().__init__(folder, camera)
        self._images, self._annotations, self._results = list[Any](), list[Any](), list[Any]()

    def _add_image(self, image: LabelledImage) -> None:
        self._write(f"images/{image.name}{image.ending}", image.data, is_new=True)
        number = len(self._images) + 1
        size = {"width": image.width_px, "height": image.height_px}
        origin = {"camera": image.camera, "frame": image.frame, "stamp_ns": image.stamp_ns}
        self._images.append({"id": number, "file_name": f"{image.name}{image.ending}", **size, **origin})
        for box in self._boxes(image.labels, number):
            width, height = box["bbox"][2:]
            ids = {"id": len(self._annotations) + 1, "iscrowd": 0, "area": width * height}
            self._annotations.append(ids | box)
        keys = ("image_id", "category_id", "bbox", "score")
        self._results += [{key: box[key] for key in keys} for box in self._boxes(image.found, number)]

    def finish(self) -> None:
        """See `ImageWriter`."""
        categories = [{"id": number + 1, "name": name} for name, number in self._numbers.items()]
        instances = {"images": self._images, "annotations": self._annotations, "categories": categories}
        for path, value in (("annotations/instances.json", instances), ("results.json", self._results)):
            self._write(path, json.dumps(value, allow_nan=False).encode())

    def _track(self, track: int) -> int:
        """The number of a track of a scene, from 1 over all scenes: those of a truth may be too large for JSON."""
        return self._tracks.setdefault((self._scenes, track), len(self._tracks) + 1)

    def _boxes(self, labels: ImageLabels, image_id: int) -> list[dict[str, Any]]:
        boxes = []
        for row, (left, top, right, bottom) in enumerate(labels.xyxy.astype(np.float64).round(2).tolist()):
            box = {
                "image_id": image_id,
                "category_id": self._numbers[str(labels.names[row])] + 1,
                "bbox": [left, top, round(right - left, 2), round(bottom - top, 2)],
                "score": round(float(labels.scores[row]), 6),
                "origin": str(labels.origins[row]),
            }
            boxes.append(box | ({"track_id": self._track(int(labels.tracks[row]))} if labels.tracks[row] >= 0 else {}))
        return boxes


class YoloWriter(ImageWriter):
    """Writes `data.yaml`, `images/` and `labels/`, each with `train` and `val`, as Ultralytics trains with."""

    def _add_image(self, image: LabelledImage) -> None:
        part = "val" if image.is_late else "train"
        self._write(f"images/{part}/{image.name}{image.ending}", image.data, is_new=True)
        self.written[part] += 1
        size = image.width_px, image.height_px
        corners = image.labels.xyxy.reshape(-1, 2, 2) / size
        sizes = corners[:, 1] - corners[:, 0]
        lines = [
            f"{self._numbers[str(name)]} {x:.6f} {y:.6f} {width:.6f} {height:.6f}\n"
            for name, (x, y), (width, height) in zip(image.labels.names, corners.mean(1), sizes, strict=True)
        ]
        self._write(f"labels/{part}/{image.name}.txt", "".join(lines).encode())

    def finish(self) -> None:
        """See `ImageWriter`."""
        names = {number: name for name, number in self._numbers.items()}
        data = {"train": "images/train", "val": "images/val", "names": names}
        self._write("data.yaml", yaml.safe_dump(data, sort_keys=False, allow_unicode=True).encode())
        empty = [part for part in ("train", "val") if part not in self.written]
        self.remarks += [f"no images in images/{part}: the results are too short to be shared out" for part in empty]
