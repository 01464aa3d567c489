"""KITTI's object and tracking benchmarks (cvlibs.net/datasets/kitti, readme.txt of the development kits).

Labels stand in a rectified frame of one camera: x right, y down, z forward. Their boxes turn about its y axis alone, so
that frame is level here (`R0_rect`), and the projection `P0` to `P3` has the tilt of the camera: of a camera that is
level, it is its camera matrix as always.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import NEAR_M, CameraModel
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.geometry.boxes import box_corners, wrap_angle
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.writers.datasets.frame import DatasetBoxes, DatasetFrame, DatasetScene, DatasetWriter, pinhole, write_image

KITTI_NAMES: Mapping[str, str] = {
    "car": "Car",
    "van": "Van",
    "truck": "Truck",
    "pedestrian": "Pedestrian",
    "person": "Pedestrian",
    "person_sitting": "Person_sitting",
    "cyclist": "Cyclist",
    "bicycle": "Cyclist",
    "tram": "Tram",
}

TRACKING_NAMES: Mapping[str, str] = {**KITTI_NAMES, "person_sitting": "Person"}

MIN_SIDE_PX = 2.0
"""Minimum width and height of a box in the image: less shows nothing of an object."""

CAMERAS = range(4)
"""Every calibration has four projections; here all are of the one camera."""

RESULTS = "results/lidcam/data"

MIN_FORWARD = 1e-6
"""Minimum length of the optical axis from above: one that looks straight down has none, and its top edge takes over."""


def level_rectification(camera: CameraSensor) -> F64:
    """(3, 3) R0_rect: from the frame of a camera to the level frame that looks the same way."""
    R_site_camera = camera.T_camera_site.matrix[:3, :3].T
    forward = R_site_camera[:2, 2]
    if np.hypot(*forward) < MIN_FORWARD:
        forward = -R_site_camera[:2, 1]
    x, y = forward / np.hypot(*forward)
    R_rect_site = np.array([[y, -x, 0.0], [0.0, 0.0, -1.0], [x, y, 0.0]])
    return np.asarray(R_rect_site @ R_site_camera, np.float64)


class KittiWriter(DatasetWriter):
    """Writes the object benchmark: `training/` with a file per frame, and `results/lidcam/data/` for its evaluation.

    `label_2` has the truth where there is one, else the objects; the results always have the objects, with scores.
    `image_2` is the wanted camera, else the first that has images.
    """

    is_tracking = False
    names: Mapping[str, str] = KITTI_NAMES
    transforms = "R0_rect:", "Tr_velo_to_cam:", "Tr_imu_to_velo:"
    image_folder, label_folder = "training/image_2", "training/label_2"

    def __init__(self, folder: Path, camera: str = "") -> None:
        super().__init__(folder, camera)
        self._sequence, self._count = "", 0
        self._lengths: list[int] = []  # of the sequences
        self._true_tracks: dict[int, int] = {}
        self._scene: DatasetScene
        self._camera: CameraSensor
        self._model: CameraModel
        self._T_rect_site: F64

    def begin(self, scene: DatasetScene) -> None:
        """See `DatasetWriter`."""
        known = [camera.name for camera in scene.cameras]
        if not known:
            raise OutputError(
                f"{scene.name}: KITTI's labels go with the images of a camera, found none in the result: process the "
                "recording with cameras and output.images=true"
            )
        if self._wanted and self._wanted not in known:
            raise OutputError(f"{scene.name}: expected a camera with images, {', '.join(known)}, found {self._wanted}")
        self._camera = scene.cameras[known.index(self._wanted) if self._wanted else 0]
        if not self._wanted and len(known) > 1:
            self.remarks.append(f"{scene.name}: image_2 is {self._camera.name}; --camera takes another of {len(known)}")
        self._scene, self._model = scene, pinhole(self._camera.model)
        self._T_rect_site = pose_matrix(level_rectification(self._camera)) @ self._camera.T_camera_site.matrix
        self._lengths.append(0)
        if self.is_tracking:
            self._sequence, self._count, self._true_tracks = f"{len(self._lengths) - 1:04d}", 0, {}
            self._text_file("training/calib").write_text(self._calibration())
            for folder in (self.label_folder, RESULTS):
                self._text_file(folder).touch()

    def add_frame(self, frame: DatasetFrame) -> None:
        """See `DatasetWriter`; a frame without an image of the camera or a cloud is left out.

        Boxes in the image are those of its time, those in 3D of the frame's.
        """
        image = frame.images.get(self._camera.name)
        if image is None or frame.cloud is None:
            lacking = "a cloud" if image is not None else f"an image of {self._camera.name}"
            self.left_out[f"frames without {lacking}"] += 1
            return
        height, width = image.rgb.shape[:2]
        if (width, height) != (self._model.width_px, self._model.height_px):
            self.left_out[f"frames whose image of {self._camera.name} has another size than its calibration"] += 1
            return
        write_image(self._frame_file(self.image_folder, "png"), image.rgb)
        points = np.column_stack([frame.cloud.xyz, frame.cloud.intensity])
        self._frame_file("training/velodyne", "bin").write_bytes(points.astype("<f4").tobytes())
        if not self.is_tracking:
            self._text_file("training/calib").write_text(self._calibration())
        self._write_labels(frame)
        self.written.update(frames=1, images=1)
        self._count += 1
        self._lengths[-1] = self._count

    def finish(self) -> None:
        """See `DatasetWriter`: of the tracking benchmark, how long the sequences are, which TrackEval wants to know."""
        if self.is_tracking:
            lines = [f"{number:04d} empty 000000 {length:06d}\n" for number, length in enumerate(self._lengths)]
            (self._folder / "training" / "evaluate_tracking.seqmap.training").write_text("".join(lines))

    def _frame_file(self, folder: str, ending: str) -> Path:
        return self._file(folder, self._sequence, f"{self._count:06d}.{ending}")

    def _text_file(self, folder: str) -> Path:
        """The text of the current frame, or of its sequence."""
        return self._file(folder, f"{self._sequence or f'{self._count:06d}'}.txt")

    def _write_labels(self, frame: DatasetFrame) -> None:
        truth = frame.objects if frame.truth is None else self._numbered(frame.truth)
        for folder, boxes, has_scores in ((self.label_folder, truth, False), (RESULTS, frame.objects, True)):
            is_counted = not has_scores or frame.truth is not None  # what is left out counts once
            lines = self._lines(frame, boxes, has_scores=has_scores, is_counted=is_counted)
            with self._text_file(folder).open("a") as file:
                file.writelines(lines)
            self.written["boxes"] += 0 if has_scores else len(lines)

    def _numbered(self, truth: DatasetBoxes) -> DatasetBoxes:
        """True objects with tracks from 0 on: their own may be of any size, and TrackEval makes tables of them."""
        known = self._true_tracks
        tracks = [known.setdefault(track, len(known)) if track >= 0 else -1 for track in truth.tracks.tolist()]
        return replace(truth, tracks=np.array(tracks, np.int64))

    def _calibration(self) -> str:
        R0 = level_rectification(self._camera)
        projection = np.column_stack([self._camera.model.K @ R0.T, np.zeros(3)])
        T_camera_velo = self._camera.T_camera_site.matrix @ self._scene.T_site_cloud
        lines = {f"P{number}:": projection for number in CAMERAS}
        lines |= zip(self.transforms, (R0, T_camera_velo[:3], np.eye(4)[:3]), strict=True)
        return "".join(f"{name} {' '.join(f'{x:.12e}' for x in matrix.ravel())}\n" for name, matrix in lines.items())

    def _lines(self, frame: DatasetFrame, boxes: DatasetBoxes, *, has_scores: bool, is_counted: bool) -> list[str]:
        """The lines of the boxes that the image shows, and that have a track if that is the benchmark."""
        if self.is_tracking:
            has_track = boxes.tracks >= 0
            if is_counted and not has_track.all():
                self.left_out["boxes without a track"] += int((~has_track).sum())
            boxes = boxes.select(has_track)
        corners_camera = self._in_camera(frame, boxes)
        seen = self._model.project_boxes(corners_camera).astype(np.float64)
        is_seen = (seen[:, 2:] - seen[:, :2] >= MIN_SIDE_PX).all(1)
        if is_counted and not is_seen.all():
            self.left_out[f"boxes that {self._camera.name} does not see"] += int((~is_seen).sum())
        truncated = self._truncated(corners_camera, seen)
        R, t = self._T_rect_site[:3, :3], self._T_rect_site[:3, 3]
        places = boxes.centers @ R.T + t
        places[:, 1] += boxes.sizes[:, 2] / 2
        along = np.column_stack([np.cos(boxes.yaws), np.sin(boxes.yaws), np.zeros(len(boxes))]) @ R.T
        turns = wrap_angle(np.arctan2(-along[:, 2], along[:, 0]))
        alphas = wrap_angle(turns - np.arctan2(places[:, 0], places[:, 2]))
        lines = []
        for row in np.flatnonzero(is_seen):
            outside = float(truncated[row])  # in classes for tracks: 0 inside, 1 partly, 2 largely outside
            shown = "-1 -1" if has_scores else f"{round(2 * outside)} 0" if self.is_tracking else f"{outside:.2f} 0"
            box = " ".join(f"{x:.2f}" for x in seen[row])
            place = " ".join(f"{x:.4f}" for x in (*boxes.sizes[row, ::-1], *places[row], turns[row]))
            score = f" {boxes.scores[row]:.6f}" if has_scores else ""
            of_track = f"{self._count} {boxes.tracks[row]} " if self.is_tracking else ""
            lines.append(f"{of_track}{boxes.names[row]} {shown} {alphas[row]:.4f} {box} {place}{score}\n")
        return lines

    def _in_camera(self, frame: DatasetFrame, boxes: DatasetBoxes) -> F64:
        """(N, 8, 3) corners of boxes in the frame of the camera, at the time of its image."""
        image = frame.images[self._camera.name]
        moved_m = np.nan_to_num(boxes.velocities) * ((image.stamp_ns - frame.stamp_ns) * 1e-9)
        corners = box_corners(boxes.centers + np.pad(moved_m, ((0, 0), (0, 1))), boxes.sizes, boxes.yaws)
        T_camera_site = self._camera.T_camera_site.matrix
        if image.T_fixed_site is not None and frame.T_fixed_site is not None:
            T_camera_site = T_camera_site @ np.linalg.inv(image.T_fixed_site) @ frame.T_fixed_site
        return np.asarray(corners @ T_camera_site[:3, :3].T + T_camera_site[:3, 3])

    def _truncated(self, corners_camera: F64, seen: F64) -> F64:
        """(N,) share of each box that lies outside of the image; 1 where the box reaches behind the camera."""
        is_ahead = (corners_camera[..., 2] > NEAR_M).all(1)
        pixels, _ = self._model.project(corners_camera)
        whole = (pixels.max(1) - pixels.min(1)).prod(1)
        inside = (seen[:, 2:] - seen[:, :2]).prod(1)
        return np.where(is_ahead, np.clip(1 - inside / np.maximum(whole, 1e-9), 0, 1), 1.0)


class KittiTrackingWriter(KittiWriter):
    """Writes the tracking benchmark: a sequence for each result, in which objects without a track are left out."""

    is_tracking, names = True, TRACKING_NAMES
    transforms = "R_rect", "Tr_velo_cam", "Tr_imu_velo"  # without colons, as there
    image_folder, label_folder = "training/image_02", "training/label_02"
