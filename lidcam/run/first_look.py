"""The first look: errors of the lidars and the cameras, from frames spread over the recording, before the run.

Surfaces that two lidars see show how well they agree (`lidcam.pipeline.calibration.lidar_poses`). Boxes of the lidars
alone and the 2D boxes that match them show where a camera looks and when it took its images
(`lidcam.pipeline.calibration.camera_error`). Short stretches are enough: a camera keeps its error, and frames that
follow each other show the same objects.
"""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np

from lidcam.pipeline.calibration.camera_error import camera_error
from lidcam.pipeline.calibration.lidar_poses import compared_lidars
from lidcam.pipeline.calibration.overlap import BoxFrame, camera_that_fits, lens_that_fits, used_if_it_fits
from lidcam.pipeline.calibration.pairs import TrackedPairs, tracked_pairs
from lidcam.pipeline.core.arrays import F64, join_rows
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.frame import FrameResult, SensorBundle
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.rotations import rotation_vectors
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.fusion.belief.memory import MIN_VISIBLE_SHARE
from lidcam.pipeline.fusion.belief.visibility import hidden_by_points
from lidcam.pipeline.parallel.process import copied_workers
from lidcam.pipeline.stages.combine import Combine
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.pipeline.tracking.trackers import object_tracker
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.rig.topics.lidars import MADE_OF_OTHERS
from lidcam.readers.streams.decoders import CloudDecoder
from lidcam.run.box_sources import KnownBoxes, box_source
from lidcam.run.build import build_graph, decided, shared_results
from lidcam.run.frames import RunInput, TimeWindow, bundles, expected_frames, sensor_clocks
from lidcam.run.scene import looks
from lidcam.run.tally import DropTable

STRETCH_FRAMES = 3
"""Number of frames of a stretch: their tracks tell the speeds of objects."""

MAX_STRETCHES = 20
"""Maximum number of stretches."""

MAX_SHARE = 1 / 3
"""Maximum share of the frames that are looked at, of more than one stretch."""

MAX_APART_NS = 2_000_000
"""Maximum time between clouds that are compared where the rig's motion is unknown: 4 cm at 20 m/s."""

BY_P = "P of its CameraInfo (no distortion)"
"""Source of the intrinsics of a camera whose images turned out to be rectified."""

BY_P_NOTE = "P of its CameraInfo is used, without distortion: it fits the 2D boxes better than K"
"""The note on such a camera."""

FREE = np.array([True, True, True, False, False, False, True])
"""Values that are corrected: direction and clock. A wrong place of a camera looks much like a habit of its detector."""


def with_agreeing_lidars(source: RunInput) -> RunInput:
    """The source with its lidars compared and moved so that they agree, unless the settings keep them as recorded."""
    rig = source.rig
    if len(rig.lidars) < 2 or all(lidar.topic in MADE_OF_OTHERS for lidar in rig.lidars):  # the parts of one cloud
        return source
    compared = compared_lidars(rig.lidars, rig.site_frame, [*_compared_clouds(source)])
    is_used = compared.agreeing and source.config.fuse.calibration != "recorded"
    lidars = compared.agreeing if is_used else rig.lidars
    return replace(source, rig=replace(rig, lidars=lidars), compared=compared)


def _compared_clouds(source: RunInput) -> Iterator[list[F64]]:
    """The points (N, 3) of each lidar in the site frame at some times of what is processed.

    Left out is where the rig moves, or may move, between the clouds and nobody knows how.
    """
    config, rig, drops = source.config, source.rig, DropTable("skip")
    off = {one: getattr(config.combine, one).model_copy(update={"enabled": False}) for one in ("outliers", "ground")}
    decode, combine = CloudDecoder(rig, config, on_bad="skip"), Combine(rig, config.combine.model_copy(update=off))
    for begin_ns in looks(source.recording, source.window.start_ns, source.window.stop_ns):
        stretch = replace(source, window=replace(source.window, start_ns=begin_ns), copied=(), drawn=())
        seen = bundles(stretch, drops, SyncStats(), sensor_clocks(rig, source.motion, drops))
        found = [(bundle, decode(bundle)) for bundle in islice(seen, STRETCH_FRAMES)]
        if not found:
            continue
        bundle, clouds = max(found, key=lambda one: len(one[1]))
        combined = combine(bundle, clouds)
        is_known = len(combined.compensated) == len(clouds) or not source.settings.moves
        if is_known or np.ptp([cloud.stamp_ns for cloud in clouds.values()]) <= MAX_APART_NS:
            xyz = combined.detection_cloud.xyz.astype(np.float64)
            yield [xyz[combined.detection_lidar_index == row] for row in range(len(rig.lidars))]


def corrected_by_recording(source: RunInput, known: KnownBoxes, workers: int) -> RunInput:
    """The source with cameras corrected by the recording; a camera that shows too little stays as recorded.

    One that fits nowhere is not used. Where its CameraInfo does not tell whether images are rectified, K and P are
    compared first. `known` gets the boxes of the frames that are looked at.

    Raises:
        ModelError: a network cannot be loaded.
    """
    config, rig = source.config, source.rig
    if config.fuse.calibration == "recorded" or box_source(config, rig) == "none" or not rig.lidars:
        return source
    found, seen = defaultdict[str, list[TrackedPairs]](list), defaultdict[str, list[BoxFrame]](list)
    plain = defaultdict[str, list[BoxFrame]](list)
    for frame in _looked_at(source, known, workers):
        for name, pairs in tracked_pairs(frame):
            found[name].append(pairs)
        for name, boxes in frame.detections.cameras.items() if len(frame.detections.lidar) else ():
            seen[name].append(BoxFrame(frame.detections.lidar, boxes.xyxy, boxes.class_ids))
            plain[name].append(seen[name][-1]._replace(objects=_unhidden(frame, name)))
    fitting = tuple(_fitting(camera, seen[camera.name], plain[camera.name]) for camera in rig.cameras)
    if fitting != rig.cameras:  # other pairs match: look again
        return corrected_by_recording(replace(source, rig=replace(rig, cameras=fitting)), known, workers)
    cameras = tuple(_corrected(camera, found[camera.name], source) for camera in rig.cameras)
    return replace(source, rig=replace(rig, cameras=cameras))


def with_corrections(found: Discovery, rig: Rig) -> Discovery:
    """The discovery with the intrinsics of the rig after the first look, and notes on these and on moved lidars."""
    moved = ", ".join(filter(None, map(_moved_text, found.rig.lidars, rig.lidars)))
    pairs = zip(found.rig.cameras, rig.cameras, strict=True)
    changed = {used.name for camera, used in pairs if camera.rectified is not None and used.rectified is None}
    sources = [replace(one, intrinsics=BY_P) if one.sensor in changed else one for one in found.sources]
    notes = [f"{camera.name}: {BY_P_NOTE}" for camera in rig.cameras if camera.name in changed]
    if moved:
        notes.insert(0, f"lidars moved so that they agree: {moved} (--set fuse.calibration=recorded: as recorded)")
    return replace(found, sources=tuple(sources), notes=(*found.notes, *notes))


def _moved_text(recorded: LidarSensor, used: LidarSensor) -> str:
    """How far a lidar was moved; empty where that is less than the figures show."""
    step = used.T_site_lidar.matrix @ np.linalg.inv(recorded.T_site_lidar.matrix)
    way_m = np.linalg.norm(used.T_site_lidar.translation - recorded.T_site_lidar.translation)
    turn_deg = np.degrees(np.linalg.norm(rotation_vectors(step[None, :3, :3])))
    figures = f"{way_m:.2f} m and {turn_deg:.2f} degrees"
    return f"{used.name} by {figures}" if figures != "0.00 m and 0.00 degrees" else ""


def _unhidden(frame: FrameResult, name: str) -> Boxes3D:
    """The objects of the lidars that no point hides from a camera."""
    boxes = frame.detections.lidar
    corners, rows = box_corners(boxes.centers, boxes.sizes, boxes.yaws), np.arange(len(boxes))
    hidden = hidden_by_points([frame.views[name]], frame.combined.detection_cloud.xyz, corners, 0 * rows, rows)
    return boxes.select(hidden <= 1 - MIN_VISIBLE_SHARE)


def _fitting(camera: CameraSensor, frames: list[BoxFrame], plain: list[BoxFrame]) -> CameraSensor:
    return used_if_it_fits(camera_that_fits(lens_that_fits(camera, frames), frames), frames, plain)


def _corrected(camera: CameraSensor, found: list[TrackedPairs], source: RunInput) -> CameraSensor:
    if not found or not camera.fit.is_used:
        return camera
    error = camera_error(join_rows(*found), camera, source.rig.lidar_xyz, source.config.fuse, FREE)
    return camera if error is None else error.applied_to(camera)


def _looked_at(source: RunInput, known: KnownBoxes, workers: int) -> Iterator[FrameResult]:
    """The frames of some stretches, with online tracks."""
    track = source.config.track.model_copy(update={"mode": "online", "odometry": "recorded"})
    config = source.config.model_copy(update={"track": track})
    source = replace(source, config=config, copied=(), drawn=())
    drops = DropTable("skip")
    make_graph = partial(build_graph, config, source.rig, known, source.given, on_bad=drops.on_bad)
    stages, tracker = make_graph(), object_tracker(decided(config, source.rig), source.rig, all_speeds=True)
    if tracker is None:
        raise AssertionError("online tracks have a tracker")
    expected = round(min(expected_frames(source) * MAX_SHARE, MAX_STRETCHES * STRETCH_FRAMES))
    with copied_workers(*stages, workers=workers, frames=expected) as started:
        found = shared_results(
            stages,
            _bundles(source, drops),
            source,
            make_graph=make_graph,
            workers=workers,
            expected=expected,
            started=started,
        )
        with closing(found) as frames:
            for frame in frames:
                known.keep(source.rig, frame)
                yield replace(frame, fused=tracker.add_frame(frame)[0])


def _bundles(source: RunInput, drops: DropTable) -> Iterator[SensorBundle]:
    recording, window = source.recording, source.window
    start_ns = recording.start_ns if window.start_ns is None else window.start_ns
    stop_ns = recording.end_ns + 1 if window.stop_ns is None else min(window.stop_ns, recording.end_ns + 1)
    waiting, stamps_ns, last = [start_ns], list[int](), dict[str, RawMessage]()
    while waiting:
        begin_ns = waiting.pop(0)
        stretch = replace(source, window=TimeWindow(begin_ns, stop_ns))
        clocks = sensor_clocks(source.rig, source.motion, drops)
        for bundle in islice(bundles(stretch, drops, SyncStats(), clocks, last), STRETCH_FRAMES):
            stamps_ns.append(bundle.stamp_ns)
            yield bundle
        if begin_ns == start_ns and len(stamps_ns) > 1:  # the first stretch shows how far apart frames are
            waiting = later_stretches(start_ns, stop_ns, (stamps_ns[-1] - stamps_ns[0]) / (len(stamps_ns) - 1))


def later_stretches(start_ns: int, stop_ns: int, period_ns: float) -> list[int]:
    """Log times at which stretches begin, evenly spread, after the first one, which begins at `start_ns`."""
    frames = (stop_ns - start_ns) / max(period_ns, 1.0)
    count = int(np.clip(frames * MAX_SHARE / STRETCH_FRAMES, 1, MAX_STRETCHES))
    step_ns = (stop_ns - start_ns - (STRETCH_FRAMES + 0.5) * period_ns) / max(count - 1, 1)
    return [start_ns + round(number * step_ns) for number in range(1, count)]
