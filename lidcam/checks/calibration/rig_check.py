"""Errors of the rig found from a run: poses and clocks of cameras against the lidars, and poses between lidars.

Each camera has one verdict. It comes from the 2D boxes and the boxes of the lidars, which tracks move to the time of
the image (`camera_error`); where the pose is wrong by many degrees, from the poses that fit instead (`coarse_pose`). A
lidar is judged by the surfaces that another lidar sees, too. An error is reported if it is significant and large enough
to matter: recordings without any error show a little of everything.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property, partial
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from lidcam.checks.calibration.coarse_pose import coarse_pose_warning
from lidcam.checks.calibration.first_clouds import FirstClouds
from lidcam.pipeline.calibration.camera_error import CameraError, camera_error
from lidcam.pipeline.calibration.lidar_poses import NOT_COMPARED, ComparedLidars, LidarPair
from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.calibration.overlap import BoxFrame
from lidcam.pipeline.calibration.pairs import TrackedPairs, tracked_pairs
from lidcam.pipeline.core.arrays import F64, Bools, join_rows
from lidcam.pipeline.core.frame import FrameResult, Missing
from lidcam.pipeline.core.geometry.boxes import pair_overlaps_xyxy
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.run.warning import RunWarning

T = TypeVar("T")

MAX_PAIR_FRAMES = 400
"""Maximum number of frames whose pairs are kept per camera, spread over the run."""

MAX_BOX_FRAMES = 32
"""Maximum number of frames whose boxes are kept per camera to compare poses, spread over the run."""

MIN_LASTING_IOU = 0.2
"""Minimum IoU of a 2D box with one of the image before that shows that it is no passing false one."""

MIN_SIGMAS = 4.0
"""Minimum size of a reported error, in its standard deviations."""

MIN_CAMERA_ERROR = np.array([np.radians(0.3), np.radians(0.3), np.radians(0.5), 0.07, 0.07, 0.07, 0.015])
"""Minimum size of a reported camera error: radians, shares of the object size (0.2 m among cars), seconds."""

MIN_HALF_SIGMAS = 3.0
"""Minimum size of a wrong place in either half of a run, in standard deviations."""

PLACE = slice(3, 6)
"""Values of a camera's place: they look much like habits of its detector."""

CLOCK_FIRST = (
    "this run uses that; check its clock first: on a moving rig, images of another time look like another lens"
)
"""Remedy if both focal length and clock seem wrong."""

MANY_PAIRS = 60
"""Minimum number of pairs for these limits; below, habits of the 2D boxes look like errors."""

FEW_PAIRS_FACTOR = 3.0
"""Factor on the limits of cameras with fewer pairs."""

REMEDY = "check it with `lidcam inspect --check`, or recalibrate it"

FITS_NOWHERE = "its 2D boxes and the objects of the lidars in its view lie apart"
UNUSED = "this run does not use its boxes (--set fuse.calibration=recorded: used all the same)"
"""Finding, if the pairs of boxes show no better one, and consequence for a camera that fits nowhere."""

BODY_FRAMES = frozenset({"base_link", "base_footprint", "map", "odom"})
"""Frames to which drivers bring the clouds of several lidars (REP 105)."""

ONE_FRAME_REMEDY = "unless their driver brings them there, give the pose of each lidar in a rig file (--rig)"

SCALES = np.array([*np.degrees([1.0, 1.0, 1.0]), 1.0, 1.0, 1.0, 1000.0])
"""Degrees, metres and milliseconds from radians, metres and seconds."""

_DIRECTIONS = (
    ("looks", "degrees", "further down than calibrated", "further up than calibrated"),
    ("looks", "degrees", "further left than calibrated", "further right than calibrated"),
    ("is rolled", "degrees", "counter-clockwise", "clockwise"),
    ("is", "m", "further left than calibrated", "further right than calibrated"),
    ("is", "m", "higher than calibrated", "lower than calibrated"),
    ("is", "m", "further back than calibrated", "further ahead than calibrated"),
    ("took its images", "ms", "later than their stamps say", "earlier than their stamps say"),
)
"""True direction and place of a camera for a positive and for a negative value: objects that appear further right than
expected are seen by a camera that looks further left."""

_AXES = ("about x", "about y", "about z", "along x", "along y", "along z")


class CameraVerdict(NamedTuple):
    """The verdict on one camera."""

    camera: CameraSensor  # As the run uses it
    pair_count: int  # Number of pairs of boxes
    track_count: int  # Number of tracks they belong to
    # Its error; where values are significant, fitted with these alone. None if too few pairs are known or the pose is
    # wrong by many degrees
    error: CameraError | None
    significant: Bools  # (7,) values of the error that are reported
    coarse: RunWarning | None  # Warning of a pose that is wrong by many degrees
    remedy: str = REMEDY

    @property
    def warning(self) -> RunWarning | None:
        """The warning of a camera that has an error."""
        if not self.camera.fit.is_used:
            finding, remedy = (self.coarse.finding, self.coarse.remedy) if self.coarse else (FITS_NOWHERE, self.remedy)
            return RunWarning(self.camera.name, finding, f"{UNUSED}; {remedy}")
        if self.camera.fit.zoom != 1:
            focal_px = self.camera.model.K[0, 0]
            finding = (
                f"its 2D boxes fit a focal length of {focal_px:.0f} px, not {focal_px / self.camera.fit.zoom:.0f} px"
            )
            if self.significant[-1]:
                return RunWarning(self.camera.name, f"{finding}, and it {self._error_words[-1]}", CLOCK_FIRST)
            return RunWarning(self.camera.name, finding, "this run uses that; recalibrate it")
        if self.error is None or not self.significant.any():
            return self.coarse
        finding = (
            f"judging by {self.error.pairs} boxes of {self.error.tracks} objects, it {', and '.join(self._error_words)}"
        )
        is_turned = any(self.camera.fit.corrected)
        remedy = f"this run corrects direction and clock; {self.remedy}" if is_turned else self.remedy
        return RunWarning(self.camera.name, finding, remedy)

    @property
    def _error_words(self) -> list[str]:
        """The significant errors in words, in order."""
        if self.error is None:
            return []
        values, sigmas = self.error.values * SCALES, self.error.sigmas * SCALES
        parts = []
        for row in np.flatnonzero(self.significant):
            verb, unit, positive, negative = _DIRECTIONS[row]
            side = positive if values[row] > 0 else negative
            parts.append(f"{verb} {_figure(values[row], sigmas[row], unit)} {side}")
        return parts

    @property
    def is_corrected(self) -> bool:
        """Whether `corrected` differs from the camera as recorded."""
        if self.error is None:
            return self.camera.fit.is_changed
        return bool(self.significant.any()) or self.camera.fit.zoom != 1

    @property
    def corrected(self) -> CameraSensor:
        """The camera without its significant errors; without any, the camera as recorded."""
        left = np.zeros(7)
        if not self.is_corrected:
            left = -np.array(self.camera.fit.corrected)
        elif self.error is not None and self.significant.any():
            left = self.error.values - np.array(self.camera.fit.corrected) * (self.error.sigmas > 0)
        if not left.any():
            return self.camera
        pose = replace(self.camera.T_camera_site, matrix=motion(left) @ self.camera.T_camera_site.matrix)
        # Stamps are later than the images by the offset: images taken later than assumed have a smaller one.
        offset_ns = self.camera.time_offset_ns - round(float(left[6]) * 1e9)
        return replace(self.camera, T_camera_site=pose, time_offset_ns=offset_ns)


class EvenSample(Generic[T]):
    """At most `max_items` items of a long run, spread evenly over it: beyond, every second one is discarded."""

    def __init__(self, max_items: int) -> None:
        self._max_items, self._items = max_items, list[T]()
        self._seen, self._stride = 0, 1

    def add(self, item: T) -> None:
        """Add the next item; whether it is kept depends on its number alone."""
        if self._seen % self._stride == 0:
            self._items.append(item)
            if len(self._items) > self._max_items:
                self._items, self._stride = self._items[::2], 2 * self._stride
        self._seen += 1

    def __iter__(self) -> Iterator[T]:
        return iter(self._items)


class RigCheck:
    """Gathers evidence about the rig over a run, and judges it at the end."""

    def __init__(self, rig: Rig, config: Config, compared: ComparedLidars = NOT_COMPARED, remedy: str = REMEDY) -> None:
        self._rig, self._config, self._compared, self._remedy = rig, config, compared, remedy
        self._pairs = {camera.name: EvenSample[TrackedPairs](MAX_PAIR_FRAMES) for camera in rig.cameras}
        # Each with which of its boxes last
        self._boxes = {camera.name: EvenSample[tuple[BoxFrame, Bools]](MAX_BOX_FRAMES) for camera in rig.cameras}
        self._last = {camera.name: np.zeros((0, 4), np.float32) for camera in rig.cameras}

    def add_frame(self, frame: FrameResult) -> None:
        """Add the evidence of one frame; one that lacks a lidar which is not silent counts against no camera."""
        bundle = frame.bundle
        lacking = [lidar.topic for lidar in self._rig.lidars if lidar.topic not in bundle.messages]
        if any(bundle.missing.get(topic) is not Missing.SILENT for topic in lacking):
            return
        for name, pairs in tracked_pairs(frame):
            self._pairs[name].add(pairs)
        for name, sample in self._boxes.items():
            found = frame.detections.cameras.get(name)
            if found is None or (len(found) and np.array_equal(found.xyxy, self._last[name])):
                continue  # The boxes of a repeated image say nothing new
            overlaps = pair_overlaps_xyxy(found.xyxy[:, None], self._last[name])[0]
            lasts = np.any(overlaps >= MIN_LASTING_IOU, axis=1)
            self._last[name] = found.xyxy
            if len(found) and len(frame.detections.lidar):
                sample.add((BoxFrame(frame.detections.lidar, found.xyxy, found.class_ids), lasts))

    @cached_property
    def cameras(self) -> tuple[CameraVerdict, ...]:
        """The verdict on each camera, after the last frame."""
        return tuple(self._camera_verdict(camera) for camera in self._rig.cameras)

    def _camera_verdict(self, camera: CameraSensor) -> CameraVerdict:
        """The verdict on a camera; what is significant is fitted again alone, as an error has one cause."""
        frames, none = [*self._pairs[camera.name]], np.zeros(7, np.bool_)
        others = [other for other in self._rig.cameras if other is not camera]
        boxes = [frame for frame, _ in self._boxes[camera.name]]
        lasting = [
            frame._replace(xyxy=frame.xyxy[lasts], class_ids=frame.class_ids[lasts])
            for frame, lasts in self._boxes[camera.name]
            if lasts.any()
        ]
        coarse = coarse_pose_warning(camera, others, boxes, lasting, self._rig.lidar_xyz)
        if not frames:
            return CameraVerdict(camera, 0, 0, None, none, coarse)
        pairs = join_rows(*frames)
        counts = len(pairs), len(np.unique(pairs.tracks))
        if coarse is not None:
            return CameraVerdict(camera, *counts, None, none, coarse)
        estimate = partial(camera_error, camera=camera, lidar_xyz=self._rig.lidar_xyz, config=self._config.fuse)
        error = estimate(pairs)
        if error is None:
            return CameraVerdict(camera, *counts, None, none, None)
        min_error = MIN_CAMERA_ERROR * error.units * (1.0 if error.pairs >= MANY_PAIRS else FEW_PAIRS_FACTOR)
        corrected = np.array(camera.fit.corrected)
        significant = _significant(corrected + error.values, error.sigmas, min_error)
        if significant[PLACE].any():
            significant[PLACE] &= _holds_in_halves(pairs, error, estimate)[PLACE]
        while significant.any() and (alone := estimate(pairs, free=significant)) is not None:
            still = significant & _significant(corrected + alone.values, alone.sigmas, min_error)
            if (still == significant).all():
                error = alone
                break
            significant = still
        error = replace(error, values=corrected * (error.sigmas > 0) + error.values)
        return CameraVerdict(camera, *counts, error, significant, None, self._remedy)

    @property
    def lidars(self) -> tuple[LidarPair, ...]:
        """Any two lidars."""
        return self._compared.pairs

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each two lidars, and for each camera, with an error."""
        found = [*map(self._lidar_warning, self.lidars), *(camera.warning for camera in self.cameras)]
        return tuple(warning for warning in found if warning is not None)

    def _lidar_warning(self, pair: LidarPair) -> RunWarning | None:
        """The warning of two lidars that disagree, or that count as standing at one place without any evidence."""
        if pair.error is None:
            one, other = pair.first.T_site_lidar, pair.second.T_site_lidar
            if one.src != other.src or one.src in BODY_FRAMES or not np.array_equal(one.matrix, other.matrix):
                return None
            finding = f"its clouds and {pair.first.name}'s are all in frame {one.src!r}, but show no common surfaces"
            return RunWarning(pair.second.name, finding, ONE_FRAME_REMEDY)
        if not pair.error.large.any():
            return None
        values, sigmas = pair.error.values * SCALES[:6], pair.error.sigmas * SCALES[:6]
        parts = [
            f"{_figure(values[row], sigmas[row], 'degrees' if row < 3 else 'm')} {_AXES[row]}"
            for row in np.flatnonzero(pair.error.large)
        ]
        finding = f"what {pair.second.name} sees lies beside what {pair.first.name} sees, by {' and '.join(parts)}"
        is_moved = self._config.fuse.calibration != "recorded"
        remedy = f"this run moves lidars so that they agree; {self._remedy}" if is_moved else self._remedy
        return RunWarning((pair.first if pair.is_first_off else pair.second).name, finding, remedy)

    @property
    def correction_count(self) -> int:
        """Number of sensors that `corrected` changes."""
        moved = [
            not np.allclose(before.T_site_lidar.matrix, after.T_site_lidar.matrix, rtol=0, atol=1e-6)
            for before, after in zip(self._rig.lidars, self._compared.agreeing, strict=False)  # none if all agree
        ]
        return sum(one.is_corrected for one in self.cameras) + sum(moved)

    def corrected(self) -> Rig:
        """The rig without its significant errors: lidars that disagree are moved so that all agree."""
        cameras = tuple(verdict.corrected for verdict in self.cameras)
        return replace(self._rig, cameras=cameras, lidars=self._compared.agreeing or self._rig.lidars)


class CalibrationCheck:
    """Checks the poses and clocks of lidars and cameras over a run."""

    def __init__(self, rig: Rig, config: Config, compared: ComparedLidars = NOT_COMPARED) -> None:
        self._first_clouds, self._rig_check = FirstClouds(rig, config), RigCheck(rig, config, compared)

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        self._first_clouds.add_messages(frame.bundle.messages.values())
        self._rig_check.add_frame(frame)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each sensor at most; cameras only where the lidars are right: misplaced objects match no camera.

        Those that are not used are always named.
        """
        if of_lidars := self._first_clouds.lidar_warnings:
            unused = (one.warning for one in self._rig_check.cameras if not one.camera.fit.is_used)
            return (*of_lidars, *filter(None, unused))
        found: dict[str, RunWarning] = {}
        for warning in (*self._rig_check.warnings, *self._first_clouds.camera_warnings):
            found.setdefault(warning.subject, warning)
        return tuple(found.values())


def _holds_in_halves(
    pairs: TrackedPairs, error: CameraError, estimate: Callable[[TrackedPairs], CameraError | None]
) -> Bools:
    """(7,) whether an error is found in both halves of the run: a real one does not come and go."""
    is_late = pairs.stamps_ns > np.median(pairs.stamps_ns)
    holds = np.ones(len(error.values), np.bool_)
    for half in map(estimate, (pairs.select(~is_late), pairs.select(is_late))):
        holds &= half is not None and half.values * np.sign(error.values) > MIN_HALF_SIGMAS * half.sigmas
    return holds


def _significant(values: F64, sigmas: F64, min_error: F64) -> Bools:
    return np.asarray((np.abs(values) > MIN_SIGMAS * sigmas) & (np.abs(values) > min_error))


def _figure(value: float, sigma: float, unit: str) -> str:
    digits = 0 if unit == "ms" else 2
    return f"{abs(value):.{digits}f} ± {sigma:.{digits}f} {unit}"
