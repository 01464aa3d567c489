"""Cameras whose 2D boxes do not lie on the objects that the lidars see: their calibration is wrong.

How well a pose fits is the mean, over the 2D boxes, of the best IoU with an object of the same frame that is projected
with that pose. Measured on the sample recordings and on KITTI with a network: 0.52 to 0.77 as calibrated; for a camera
that is turned by 10 degrees or more at most 0.37 (KITTI: dense traffic, large boxes), elsewhere 0.20; with the pose of
another camera at most 0.14, with the inverse 0.08. Where it fits badly, other poses are tried: one that fits much
better shows what is wrong.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from lidcam.checks.calibration.evenly_kept import EvenlyKept
from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.rotations import matrix_of_rpy
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.run.warning import RunWarning

MAX_FRAMES = 32
"""Frames that are kept, spread over the run."""

MIN_FRAMES, MIN_BOXES = 5, 15
"""A camera with fewer frames with boxes, or fewer boxes in them, is not judged."""

DOUBTFUL = 0.45
"""A pose that fits less well than this is compared with others."""

BAD = 0.15
"""A pose that fits less well than this is wrong, or the boxes are of objects that the lidars do not see."""

FITS, BETTER = 0.4, 1.5
"""A pose is the better one if it fits at least this well, and this many times better than the given one."""

YAWS_DEG = (0, 2.5, -2.5, 5, -5, 10, -10, 15, -15, 20, -20, 30, -30)
PITCHES_DEG = (0, 2.5, -2.5, 5, -5, 10, -10, 20, -20)
"""How far a camera may be turned; objects in an image are wide enough that such steps find them."""

NEAR_DEG = 2.5
"""A camera that is turned by no more still matches most of its objects."""


class _Sample(NamedTuple):
    """The boxes of one frame: N objects in the site frame, and 2D boxes (M, 4) by camera."""

    objects: Boxes3D
    boxes: Mapping[str, F32]


class CameraFit:
    """Keeps the boxes of some frames, and looks at the end how well they fit."""

    def __init__(self, rig: Rig) -> None:
        self._cameras = {camera.name: camera for camera in rig.cameras}
        self._samples = EvenlyKept[_Sample](MAX_FRAMES)

    def add(self, frame: FrameResult) -> None:
        """Look at one frame."""
        objects = frame.detections.lidar
        boxes = {name: found.xyxy for name, found in frame.detections.cameras.items() if len(found)}
        if not len(objects) or not boxes:
            return
        self._samples.add(_Sample(objects, boxes))

    def warnings(self) -> tuple[tuple[RunWarning, ...], tuple[RunWarning, ...]]:
        """One for each camera whose boxes do not fit.

        Returns:
            Of cameras whose boxes fit with quite another pose; of those that are turned a little, or fit with none.
        """
        found = [warning for camera in self._cameras.values() if (warning := self._warning(camera))]
        first, second = (tuple(one for one, is_far in found if is_far == far) for far in (True, False))
        return first, second

    def _warning(self, camera: CameraSensor) -> tuple[RunWarning, bool] | None:
        samples = [sample for sample in self._samples if camera.name in sample.boxes]
        count = sum(len(sample.boxes[camera.name]) for sample in samples)
        if len(samples) < MIN_FRAMES or count < MIN_BOXES:
            return None
        pairs = _Pairs.of(camera, samples)
        given = pairs.fit(camera.T_camera_site.matrix)
        if given >= DOUBTFUL:
            return None
        boxes = f"its {count} boxes overlap the objects of the lidars by {given:.0%} on average"
        for candidates in (self._exchanged(camera), _turned(camera)):
            fits = ((pairs.fit(pose.T_camera_site), pose) for pose in candidates)
            fit, best = max(fits, key=lambda one: one[0])
            if fit >= max(FITS, BETTER * given):
                return RunWarning(camera.name, f"{boxes}, and by {fit:.0%} {best.how}", best.remedy), best.is_far
        if given >= BAD:
            return None
        remedy = "check its intrinsics and extrinsics; or does it look where no lidar does?"
        return RunWarning(camera.name, boxes, remedy), False

    def _exchanged(self, camera: CameraSensor) -> Iterator["_Pose"]:
        """The inverse of the camera's pose, and the poses of the other cameras."""
        yield _Pose(
            camera.T_camera_site.inverse().matrix,
            "with the inverse of its extrinsics",
            "they look inverted: T_camera_site maps points of the site to the camera, T_site_camera the other way",
        )
        for other in self._cameras.values():
            if other is not camera:
                how = f"with the extrinsics of {other.name}"
                yield _Pose(
                    other.T_camera_site.matrix,
                    how,
                    "check which extrinsics, and which topics, belong to which camera",
                )


class _Pose(NamedTuple):
    """Another pose (4, 4) of a camera: its name, what to do if it fits, and whether it is far from the given one."""

    T_camera_site: F64
    how: str
    remedy: str
    is_far: bool = True


def _turned(camera: CameraSensor) -> Iterator[_Pose]:
    """The camera's pose, turned by some degrees."""
    for yaw_deg in YAWS_DEG:
        for pitch_deg in PITCHES_DEG:
            turn = np.eye(4)
            turn[:3, :3] = matrix_of_rpy(np.deg2rad([pitch_deg, yaw_deg, 0.0]))
            # What moves right and up in the image does so because the camera looks further left and down.
            sideways = f"{abs(yaw_deg):g} degrees further {'left' if yaw_deg > 0 else 'right'}"
            upright = f"{abs(pitch_deg):g} degrees further {'down' if pitch_deg > 0 else 'up'}"
            words = [text for text, angle in ((sideways, yaw_deg), (upright, pitch_deg)) if angle]
            remedy = "calibrate it again, or see whether its clock is off (time_offset_ms in the rig file)"
            is_far = max(abs(yaw_deg), abs(pitch_deg)) > NEAR_DEG
            yield _Pose(turn @ camera.T_camera_site.matrix, f"if it looked {' and '.join(words)}", remedy, is_far)


class _Pairs(NamedTuple):
    """The corners (N, 8, 3) of the objects of several frames, and a camera's 2D boxes (M, 4), clipped to the image.

    The rows (K,) are of all pairs of an object and a 2D box of the same frame, ordered by the latter.
    """

    camera: CameraSensor
    corners_site: F64
    boxes: F64
    rows3d: I64
    rows2d: I64

    @classmethod
    def of(cls, camera: CameraSensor, samples: list[_Sample]) -> "_Pairs":
        boxes = np.concatenate([sample.boxes[camera.name] for sample in samples]).astype(np.float64)
        size = np.array([camera.model.width_px, camera.model.height_px] * 2, np.float64)
        counts3d = np.array([len(sample.objects) for sample in samples])
        counts2d = np.array([len(sample.boxes[camera.name]) for sample in samples])
        frame_of_box = np.repeat(np.arange(len(samples)), counts2d)
        repeats = counts3d[frame_of_box]
        rows2d = np.repeat(np.arange(len(boxes)), repeats)
        within = np.arange(len(rows2d)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        rows3d = np.repeat((np.cumsum(counts3d) - counts3d)[frame_of_box], repeats) + within
        placed = ((sample.objects.centers, sample.objects.sizes, sample.objects.yaws) for sample in samples)
        corners = np.concatenate([box_corners(*of_frame) for of_frame in placed])
        return cls(camera, corners, np.clip(boxes, 0, size), rows3d, rows2d)

    def fit(self, T_camera_site: F64) -> float:
        """Mean over the 2D boxes of the best IoU with an object, for a pose (4, 4) of the camera."""
        R, t = T_camera_site[:3, :3], T_camera_site[:3, 3]
        projected = self.camera.model.project_boxes(np.einsum("ij,nkj->nki", R, self.corners_site) + t)
        first, second = projected[self.rows3d].astype(np.float64), self.boxes[self.rows2d]
        shared = np.minimum(first[:, 2:], second[:, 2:]) - np.maximum(first[:, :2], second[:, :2])
        extents = [(boxes[:, 2:] - boxes[:, :2]).prod(1) for boxes in (first, second)]
        overlap = np.where((shared > 0).all(1), shared.prod(1), 0.0)  # not where the object is out of view: NaN
        iou = np.divide(overlap, sum(extents) - overlap, out=np.zeros(len(overlap)), where=overlap > 0)
        best = np.zeros(len(self.boxes))
        np.maximum.at(best, self.rows2d, iou)
        return float(best.mean())
