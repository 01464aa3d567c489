"""Errors of the rig found from a run: poses and clocks of cameras against the lidars, and poses between lidars.

Each camera has one verdict. It comes from the 2D boxes and the boxes of the lidars, which tracks move to the time of
the image (`camera_error`); where the pose is wrong by many degrees, from the poses that fit instead (`coarse_pose`). A
lidar is judged by the surfaces that another lidar sees, too. An error is reported if it is significant and large enough
to matter: recordings without any error show a little of everything.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import combinations
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from lidcam.checks.calibration.coarse_pose import coarse_pose_warning
from lidcam.pipeline.calibration.camera_error import CameraError, camera_error
from lidcam.pipeline.calibration.lidar_error import LidarError, lidar_error
from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.calibration.overlap import BoxFrame
from lidcam.pipeline.calibration.pairs import TrackedPairs, tracked_pairs
from lidcam.pipeline.core.arrays import F64, Bools, join_rows
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.run.warning import RunWarning

T = TypeVar("T")

MAX_PAIR_FRAMES = 400
"""Maximum number of frames whose pairs are kept per camera, spread over the run."""

MAX_BOX_FRAMES = 32
"""Maximum number of frames whose boxes are kept per camera to compare poses, spread over the run."""

MAX_CLOUDS = 2
"""Maximum number of frames whose clouds are kept, spread over the run."""

MIN_SIGMAS = 4.0
"""Minimum size of a reported error, in its standard deviations."""

MIN_CAMERA_ERROR = np.array([np.radians(0.3), np.radians(0.3), np.radians(0.5), 0.07, 0.07, 0.07, 0.015])
"""Minimum size of a reported camera error: radians, shares of the object size (0.2 m among cars), seconds."""

MIN_HALF_SIGMAS = 3.0
"""Minimum size of a wrong place in either half of a run, in standard deviations."""

PLACE = slice(3, 6)
"""Values of a camera's place: they look much like habits of its detector."""

MANY_PAIRS = 60
"""Minimum number of pairs for these limits; below, habits of the 2D boxes look like errors."""

FEW_PAIRS_FACTOR = 3.0
"""Factor on the limits of cameras with fewer pairs."""

MIN_LIDAR_ERROR = np.array([*np.radians([0.3, 0.3, 0.3]), 0.03, 0.03, 0.03])
"""Minimum size of a reported lidar error: radians, metres."""

MAX_STANDING_SPEED = 0.1
"""Maximum speed of a standing object, in its lengths per second."""

MOVING_MARGIN = 1.3
"""Scale of the length and width of a moving box; the points in it are left out."""

REMEDY = "check it with `lidcam inspect --check`, or recalibrate it"

CORRECTED_REMEDY = f"this run corrects direction and clock; {REMEDY}"

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

    camera: CameraSensor  # As calibrated
    pair_count: int  # Number of pairs of boxes
    track_count: int  # Number of tracks they belong to
    # Its error; where values are significant, fitted with these alone. None if too few pairs are known or the pose is
    # wrong by many degrees
    error: CameraError | None
    significant: Bools  # (7,) values of the error that are reported
    coarse: RunWarning | None  # Warning of a pose that is wrong by many degrees

    @property
    def warning(self) -> RunWarning | None:
        """The warning of a camera that has an error."""
        if self.error is None or not self.significant.any():
            return self.coarse
        values, sigmas = self.error.values * SCALES, self.error.sigmas * SCALES
        parts = []
        for row in np.flatnonzero(self.significant):
            verb, unit, positive, negative = _DIRECTIONS[row]
            side = positive if values[row] > 0 else negative
            parts.append(f"{verb} {_figure(values[row], sigmas[row], unit)} {side}")
        finding = f"judging by {self.error.pairs} boxes of {self.error.tracks} objects, it {', and '.join(parts)}"
        return RunWarning(self.camera.name, finding, CORRECTED_REMEDY if any(self.camera.fit.corrected) else REMEDY)

    @property
    def corrected(self) -> CameraSensor:
        """The camera without its significant errors."""
        if self.error is None or not self.significant.any():
            return self.camera
        T_camera_site = self.camera.T_camera_site
        pose = replace(T_camera_site, matrix=motion(self.error.values) @ T_camera_site.matrix)
        # Stamps are later than the images by the offset: images taken later than assumed have a smaller one.
        offset_ns = self.camera.time_offset_ns - round(float(self.error.values[6]) * 1e9)
        return replace(self.camera, T_camera_site=pose, time_offset_ns=offset_ns)


class LidarVerdict(NamedTuple):
    """The verdict on two lidars."""

    first: LidarSensor  # The reference
    second: LidarSensor  # The lidar that is judged
    error: LidarError | None  # The error of the second; None if they see too little in common
    significant: Bools  # (6,) values of the error that are reported

    @property
    def warning(self) -> RunWarning | None:
        """The warning of two lidars that disagree."""
        if self.error is None or not self.significant.any():
            return None
        values, sigmas = self.error.values * SCALES[:6], self.error.sigmas * SCALES[:6]
        parts = [
            f"{_figure(values[row], sigmas[row], 'degrees' if row < 3 else 'm')} {_AXES[row]}"
            for row in np.flatnonzero(self.significant)
        ]
        finding = f"what it sees lies beside what {self.first.name} sees, by {' and '.join(parts)}: one of them is off"
        return RunWarning(self.second.name, finding, REMEDY)

    @property
    def corrected(self) -> LidarSensor:
        """The second lidar without its error, if that is significant."""
        if self.error is None or not self.significant.any():
            return self.second
        pose, step = self.second.T_site_lidar, motion(self.error.values)
        matrix = pose.matrix.copy()
        matrix[:3, :3] = step[:3, :3] @ matrix[:3, :3]
        matrix[:3, 3] += step[:3, 3]
        return replace(self.second, T_site_lidar=replace(pose, matrix=matrix))


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

    def __init__(self, rig: Rig, config: Config) -> None:
        self._rig, self._config = rig, config
        self._pairs = {camera.name: EvenSample[TrackedPairs](MAX_PAIR_FRAMES) for camera in rig.cameras}
        self._boxes = {camera.name: EvenSample[BoxFrame](MAX_BOX_FRAMES) for camera in rig.cameras}
        self._clouds = EvenSample[tuple[CombinedCloud, Boxes3D]](MAX_CLOUDS)

    def add_frame(self, frame: FrameResult) -> None:
        """Add the evidence of one frame; a frame without one of the lidars does not count against a camera."""
        if any(lidar.topic not in frame.bundle.messages for lidar in self._rig.lidars):
            return
        for name, pairs in tracked_pairs(frame):
            self._pairs[name].add(pairs)
        for name, sample in self._boxes.items():
            found = frame.detections.cameras.get(name)
            if found and len(frame.detections.lidar):
                sample.add(BoxFrame(frame.detections.lidar, found.xyxy))
        if len(self._rig.lidars) > 1 and len(frame.combined.points_by_lidar) == len(self._rig.lidars):
            self._clouds.add((frame.combined, _moving_objects(frame)))

    @cached_property
    def cameras(self) -> tuple[CameraVerdict, ...]:
        """The verdict on each camera, after the last frame."""
        return tuple(self._camera_verdict(camera) for camera in self._rig.cameras)

    def _camera_verdict(self, camera: CameraSensor) -> CameraVerdict:
        """The verdict on a camera; significant errors are fitted again alone, as an error has one cause."""
        frames, none = [*self._pairs[camera.name]], np.zeros(7, np.bool_)
        others = [other for other in self._rig.cameras if other is not camera]
        coarse = coarse_pose_warning(camera, others, [*self._boxes[camera.name]])
        if not frames:
            return CameraVerdict(camera, 0, 0, None, none, coarse)
        pairs = join_rows(*frames)
        counts = len(pairs), len(np.unique(pairs.tracks))
        if coarse is not None:
            return CameraVerdict(camera, *counts, None, none, coarse)
        lidar_xy = np.array([lidar.T_site_lidar.translation[:2] for lidar in self._rig.lidars]).reshape(-1, 2)
        estimate = partial(camera_error, camera=camera, lidar_xy=lidar_xy, config=self._config.fuse)
        error = estimate(pairs)
        if error is None:
            return CameraVerdict(camera, *counts, None, none, None)
        min_error = MIN_CAMERA_ERROR * error.units * (1.0 if error.pairs >= MANY_PAIRS else FEW_PAIRS_FACTOR)
        corrected = np.array(camera.fit.corrected)
        significant = _significant(corrected + error.values, error.sigmas, min_error)
        if significant[PLACE].any():
            significant[PLACE] &= _holds_in_halves(pairs, error, estimate)[PLACE]
        if significant.any():
            error = estimate(pairs, free=significant) or error
        error = replace(error, values=corrected * (error.sigmas > 0) + error.values)
        return CameraVerdict(camera, *counts, error, significant, None)

    @cached_property
    def lidars(self) -> tuple[LidarVerdict, ...]:
        """The verdict on each two lidars, after the last frame.

        Among three or more, the lidar that disagrees with several is the one that is wrong: it becomes the second.
        """
        lidars = range(len(self._rig.lidars))
        clouds = [_standing_points(*kept, len(lidars)) for kept in self._clouds] if len(lidars) > 1 else []
        found = {pair: self._lidar_verdict(clouds, *pair) for pair in combinations(lidars, 2)}
        wrong = [pair for pair, verdict in found.items() if verdict.significant.any()]
        for row in {*lidars}.intersection(*wrong) if len(wrong) > 1 else ():
            for pair in [pair for pair in wrong if pair[0] == row]:
                found[pair] = self._lidar_verdict(clouds, pair[1], row)
        return tuple(found.values())

    def _lidar_verdict(self, clouds: Sequence[Sequence[F64]], first: int, second: int) -> LidarVerdict:
        lidars, frames = self._rig.lidars, [(by_lidar[first], by_lidar[second]) for by_lidar in clouds]
        error = lidar_error(frames, lidars[second].T_site_lidar.translation)
        none = np.zeros(6, np.bool_)
        significant = none if error is None else _significant(error.values, error.sigmas, MIN_LIDAR_ERROR)
        return LidarVerdict(lidars[first], lidars[second], error, significant)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each two lidars, and for each camera, with an error."""
        found = [*(lidars.warning for lidars in self.lidars), *(camera.warning for camera in self.cameras)]
        return tuple(warning for warning in found if warning is not None)

    @property
    def correction_count(self) -> int:
        """Number of sensors that `corrected` changes."""
        significant = [*(one.significant for one in self.cameras), *(one.significant for one in self.lidars)]
        return sum(bool(values.any()) for values in significant)

    def corrected(self) -> Rig:
        """The rig without its significant errors; of two lidars that disagree, the second is moved."""
        lidars = {lidar.name: lidar for lidar in self._rig.lidars}
        for verdict in self.lidars:
            if lidars[verdict.second.name] is verdict.second:
                lidars[verdict.second.name] = verdict.corrected
        cameras = tuple(verdict.corrected for verdict in self.cameras)
        return replace(self._rig, cameras=cameras, lidars=tuple(lidars.values()))


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


def _moving_objects(frame: FrameResult) -> Boxes3D:
    """The objects of a frame that are not known to stand."""
    objects, tracks = frame.fused.objects, frame.fused.tracks
    if tracks is None:
        return objects
    return objects.select(~((tracks.ids != NO_TRACK) & (tracks.speeds < MAX_STANDING_SPEED * objects.sizes[:, 0])))


def _standing_points(combined: CombinedCloud, moving: Boxes3D, lidar_count: int) -> list[F64]:
    """The points (N, 3) of each lidar in the site frame, without those of moving objects."""
    parts = [(combined.detection_cloud.xyz, combined.detection_lidar_index)]
    if combined.ground_lidar_index is not None:
        parts.append((combined.ground_cloud.xyz, combined.ground_lidar_index))
    xyz, index = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    inside, _ = points_in_footprints(xyz, moving.centers[:, :2], moving.sizes[:, :2] * MOVING_MARGIN, moving.yaws)
    stands = np.ones(len(xyz), np.bool_)
    stands[inside] = False
    return [xyz[stands & (index == lidar)].astype(np.float64) for lidar in range(lidar_count)]
