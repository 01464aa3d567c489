"""Truth from KITTI's label files: of the object benchmark (label_2), and of the tracking benchmark (label_02).

A line is `type truncated occluded alpha left top right bottom height width length x y z rotation_y`, in the tracking
benchmark with `frame track_id` before it; x, y, z is the middle of the bottom of the box in the rectified frame of
camera 0 (x right, y down, z forward), rotation_y the heading about its y axis (readme.txt of the development kits).
`DontCare` are parts of the image that nobody labelled. Calibration is that of `calib/` beside the labels.

As in the benchmark, `Van` and `Person_sitting` are neither a miss nor an error, and so are objects harder than
`evaluate.kitti_difficulty`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes2D, TruthBoxes3D
from lidcam.readers.messages.objects import check_boxes
from lidcam.readers.natural_order import natural_key
from lidcam.readers.rig.importers import KittiCalibration, kitti_calibration
from lidcam.readers.truth.boxes import Labelled, class_ids_of, truth_boxes_3d
from lidcam.readers.truth.source import TruthSource

DONT_CARE = "DontCare"

NEUTRAL = frozenset({"Van", "Person_sitting"})
"""Ignored: neighbouring classes of the benchmark."""

SITTING_IN_TRACKING = "Person"
"""Name of `Person_sitting` in the tracking benchmark."""

LEFT_COLOUR_CAMERA = 2
"""Number of the camera whose images are labelled."""

MAX_REPROJECTION_PX = 2.0
"""Largest distance of points seen by a camera of the rig and by the labelled one."""

MAX_LABEL_BYTES = 16 << 20
"""Largest size of a file; those of the tracking benchmark have about 1 MB."""

MAX_NUMBER = 1e15
"""Largest number of a label: larger ones overflow in volumes and images."""

MAX_ID = 2**53
"""Largest id of a track."""

_COLUMNS, _TRACKING_COLUMNS = 15, 17

_LEVELS: Final = {"easy": (40.0, 0, 0.15), "moderate": (25.0, 1, 0.30), "hard": (25.0, 2, 0.50)}
"""Least height in pixels, largest occlusion and truncation (cvlibs.net/datasets/kitti/eval_object.php)."""


@dataclass(frozen=True, slots=True)
class KittiLabel:
    """One line of a label file."""

    label: str
    truncated: float  # Share of the object outside the image
    occluded: int  # 0 visible, 1 partly hidden, 2 largely hidden, 3 unknown
    xyxy: tuple[float, float, float, float]  # Left, top, right, bottom, pixels
    size_m: tuple[float, float, float]  # Length, width, height
    bottom_m: tuple[float, float, float]  # Middle of the bottom in the rectified frame of camera 0
    rotation_y: float  # Heading about its y axis, radians
    frame: int = 0  # Number of the frame; 0 in the object benchmark
    track_id: int = UNKNOWN  # Number of the object; `UNKNOWN` in the object benchmark

    def T_rect_box(self) -> F64:
        """(4, 4) pose of the centre of the box: x forward along its length, y left, z up."""
        along, across = math.cos(self.rotation_y), math.sin(self.rotation_y)
        x, y, z = self.bottom_m
        pose = np.eye(4)
        pose[:3, 0] = along, 0.0, -across
        pose[:3, 1] = across, 0.0, along
        pose[:3, 2] = 0.0, -1.0, 0.0
        pose[:3, 3] = x, y - self.size_m[2] / 2, z
        return pose

    def is_harder_than(self, level: str | None) -> bool:
        """Whether it is harder to find than a level of difficulty allows."""
        if level is None:
            return False
        height_px, occluded, truncated = _LEVELS[level]
        height = self.xyxy[3] - self.xyxy[1]
        return height < height_px or self.occluded > occluded or self.truncated > truncated


class KittiFile(NamedTuple):
    """The content of a label file; `is_tracking`: of the tracking benchmark, with numbers of frames and objects."""

    labels: tuple[KittiLabel, ...]
    is_tracking: bool


def is_kitti_text(text: str) -> bool:
    """Whether the first line of a text is a KITTI label."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    try:
        return bool(parse_kitti_labels(first, Path()).labels)
    except RecordingError:
        return False


def parse_kitti_labels(text: str, path: Path) -> KittiFile:
    """The labels of the file at `path`; raises RecordingError if a line is none, or of another benchmark."""
    found = []
    columns = 0
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        columns = columns or len(words)
        if len(words) != columns or columns not in (_COLUMNS, _TRACKING_COLUMNS):
            raise RecordingError(
                f"{path}: line {number}: expected {_COLUMNS} columns as in label_2 or {_TRACKING_COLUMNS} as in "
                f"label_02, the same in all lines, found {len(words)}"
            )
        try:
            found.append(_kitti_label(words))
        except ValueError as err:
            raise RecordingError(f"{path}: line {number}: expected a KITTI label, found {err}") from err
    return KittiFile(tuple(found), columns == _TRACKING_COLUMNS)


def _kitti_label(words: Sequence[str]) -> KittiLabel:
    """The label of a line; a ValueError says what was found in its place."""
    frame, track_id = 0, UNKNOWN
    if len(words) == _TRACKING_COLUMNS:
        frame, track_id, words = int(words[0]), int(words[1]), words[2:]
        if frame < 0:
            raise ValueError(f"the frame {frame}")
        if abs(track_id) > MAX_ID:
            raise ValueError(f"the track {track_id}")
    label = words[0]
    numbers = [float(word) for word in words[1:]]
    if not all(map(math.isfinite, numbers)):
        raise ValueError("numbers that are not finite")
    if max(map(abs, numbers)) > MAX_NUMBER:
        raise ValueError(f"a number beyond {MAX_NUMBER:g}")
    truncated, occluded, _, left, top, right, bottom, height, width, length, x, y, z, rotation_y = numbers
    if not (left < right and top < bottom):
        raise ValueError(f"an image box from {left:g}, {top:g} to {right:g}, {bottom:g}")
    if label != DONT_CARE and not min(height, width, length) > 0:
        raise ValueError(f"a {label} of {length:g} x {width:g} x {height:g} m")
    xyxy, size_m = (left, top, right, bottom), (length, width, height)
    return KittiLabel(label, truncated, int(occluded), xyxy, size_m, (x, y, z), rotation_y, frame, track_id)


class KittiTruth(TruthSource):
    """KITTI's labels as a source of truth; see `TruthSource`.

    The k-th file of a folder, in order of their numbers, belongs to the k-th frame of the result. A file of the
    tracking benchmark numbers its frames itself, from 0.

    `path` is a label file, or a folder of those of the object benchmark, or one that has `label_2`; the lidar of `rig`,
    the result's, is KITTI's. Raises RecordingError if the labels cannot be read, or the rig has several lidars.
    """

    def __init__(self, path: Path, rig: Rig, config: Config) -> None:
        folder = path / "label_2" if (path / "label_2").is_dir() else path
        in_folder = sorted(folder.glob("*.txt"), key=lambda file: natural_key(file.name))
        self._files = in_folder if folder.is_dir() else [path]
        if not self._files:
            raise RecordingError(f"{folder}: expected KITTI labels (000000.txt, ...), found none")
        self._rig, self._lidar, self._limits = rig, _lidar_of(rig, path), config.limits
        self._level = config.evaluate.kitti_difficulty
        self._has_region = config.evaluate.region is not None
        self._class_ids = config.class_id_of_label
        first = _labels_of(self._files[0])
        if first.is_tracking and len(self._files) > 1:
            raise RecordingError(
                f"{path}: labels of the tracking benchmark, one file a sequence: name the file of the sequence"
            )
        self._tracked = _by_frame(first.labels) if first.is_tracking else None
        self._count = len(self._files) if self._tracked is None else max(self._tracked) + 1
        self._is_short = False
        self._last: tuple[int, Sequence[KittiLabel], KittiCalibration] | None = None
        self.description = f"KITTI labels of {path}"

    @property
    def notes(self) -> tuple[str, ...]:
        """See `TruthSource`."""
        what = "file" if self._tracked is None else "frame"
        count = f"{self._count} {what}{'s' * (self._count != 1)}"
        notes = [f"{self.description}: {count}, matched with the frames of the result in their order"]
        if not self._has_region:
            notes.append(
                f"{self.description}: only what camera 2 sees is labelled, and boxes elsewhere are false; leave them "
                "out with evaluate.region=[[0,0],[70,59],[70,-59]]"
            )
        if self._is_short:
            notes.append(f"{self.description}: frames of the result from {self._count} on have no labels")
        return tuple(notes)

    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        """See `TruthSource`: the labels of the frame, in the site frame."""
        if frame >= self._count:
            self._is_short = True
            return None
        labels, calibration = self._labels(frame)
        T_site_rect = self._lidar.T_site_lidar.matrix @ np.linalg.inv(calibration.T_rect_velo)
        objects = [
            Labelled(one.label, T_site_rect @ one.T_rect_box(), one.size_m, one.track_id, self._is_ignored(one))
            for one in labels
            if one.label != DONT_CARE
        ]
        return truth_boxes_3d(stamp_ns, self._rig.site_frame, objects, self._class_ids)

    def in_image(self, camera: str, stamp_ns: int, *, frame: int) -> TruthBoxes2D | None:
        """See `TruthSource`: the labels of the left colour camera."""
        if frame >= self._count:
            return None
        labels, calibration = self._labels(frame)
        sensor = next((one for one in self._rig.cameras if one.name == camera), None)
        if sensor is None or not self._is_labelled(sensor, calibration):
            return None
        names = [one.label for one in labels]
        return TruthBoxes2D(
            stamp_ns,
            np.array([one.xyxy for one in labels], np.float32).reshape(-1, 4),
            class_ids_of(names, self._class_ids),
            np.array(names, np.str_),
            np.array([one.track_id for one in labels], np.int64),
            np.full(len(labels), UNKNOWN, np.int32),
            np.array([self._is_ignored(one) for one in labels], np.bool_),
        )

    def _labels(self, frame: int) -> tuple[Sequence[KittiLabel], KittiCalibration]:
        """The labels of a frame, and their calibration; kept for the images of the frame."""
        if self._last is None or self._last[0] != frame:
            file = self._files[0 if self._tracked is not None else frame]
            calibration = _calibration(file) if self._last is None or self._tracked is None else self._last[2]
            labels = self._read(file, frame)
            check_boxes(labels, f"{file}: frame {frame}", self._limits)
            self._last = frame, labels, calibration
        return self._last[1:]

    def _read(self, file: Path, frame: int) -> Sequence[KittiLabel]:
        if self._tracked is not None:
            return self._tracked.get(frame, ())
        found = _labels_of(file)
        if found.is_tracking:
            raise RecordingError(f"{file}: expected labels as in {self._files[0].name}, found the tracking benchmark's")
        return found.labels

    def _is_ignored(self, label: KittiLabel) -> bool:
        is_neutral = label.label in NEUTRAL or (self._tracked is not None and label.label == SITTING_IN_TRACKING)
        return label.label == DONT_CARE or is_neutral or label.is_harder_than(self._level)

    def _is_labelled(self, camera: CameraSensor, calibration: KittiCalibration) -> bool:
        """Whether a camera of the rig is the one whose images were labelled: both see the same at the same pixels."""
        projection = calibration.projections.get(LEFT_COLOUR_CAMERA)
        if projection is None:
            return False
        points_velo = np.array([[20.0, y, z, 1.0] for y in (-6.0, 0.0, 6.0) for z in (-1.5, 1.0)])
        labelled = (projection @ calibration.T_rect_velo @ points_velo.T).T
        in_camera = camera.T_camera_site.matrix @ self._lidar.T_site_lidar.matrix @ points_velo.T
        if (in_camera[2] <= 0).any() or (labelled[:, 2] <= 0).any():
            return False
        seen = (camera.model.K @ in_camera[:3]).T
        apart = labelled[:, :2] / labelled[:, 2:] - seen[:, :2] / seen[:, 2:]
        return bool(np.linalg.norm(apart, axis=1).max() <= MAX_REPROJECTION_PX)


def _lidar_of(rig: Rig, path: Path) -> LidarSensor:
    named = [lidar for lidar in rig.lidars if "velo" in f"{lidar.name} {lidar.T_site_lidar.src}".lower()]
    for found in (rig.lidars, named):
        if len(found) == 1:
            return found[0]
    raise RecordingError(
        f"{path}: KITTI's labels go with its one Velodyne, found the lidars {', '.join(one.name for one in rig.lidars)}"
    )


def _labels_of(path: Path) -> KittiFile:
    return parse_kitti_labels(read_small_text(path, MAX_LABEL_BYTES, "KITTI labels", RecordingError), path)


def _by_frame(labels: Sequence[KittiLabel]) -> dict[int, list[KittiLabel]]:
    frames: dict[int, list[KittiLabel]] = {}
    for label in labels:
        frames.setdefault(label.frame, []).append(label)
    return frames


def _calibration(labels: Path) -> KittiCalibration:
    folder = labels.absolute().parent
    places = folder.parent / "calib" / labels.name, folder / "calib" / labels.name
    place = next((place for place in places if place.is_file()), None)
    if place is None:
        raise RecordingError(
            f"{labels}: KITTI's labels stand in the frame of a camera; expected its calibration {places[0]}, found no "
            "such file"
        )
    found = kitti_calibration(read_small_text(place, MAX_YAML_BYTES, "KITTI calibration", RecordingError), place)
    if found is None:
        raise RecordingError(f"{place}: expected a calibration of KITTI with R0_rect and Tr_velo_to_cam")
    rotation = found.T_rect_velo[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=0.01):
        raise RecordingError(f"{place}: expected rotations in R0_rect and Tr_velo_to_cam, found other matrices")
    return found
