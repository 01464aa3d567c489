"""Files without messages; warnings of lidars without points, no ground, unknown motion, cameras that see nothing."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.combine import GroundConfig
from lidcam.readers.recording import Recording
from lidcam.run.frames import HEADER_BYTES, repeats
from lidcam.run.warning import RunWarning


def check_not_empty(recording: Recording) -> None:
    """Check that there is anything to read."""
    if recording.message_count == 0:
        names = ", ".join(str(path) for path in recording.paths)
        raise RecordingError(f"{names}: the recording has no messages; record it again, or check that it was closed")


MIN_EMPTY = 3
"""Minimum number of empty messages of a lidar that is named; fewer come from start-up or lost packets."""

MIN_EMPTY_SHARE = 0.1
"""Minimum share of empty messages of a lidar that is named."""


MIN_REPEATED, MIN_REPEATED_SHARE = 3, 0.1
"""Minimum number and share of a lidar's messages that have the points of the one before, but not of that before it."""

MIN_FROZEN = 10
"""Minimum number of repeated messages in a row, while another sensor sees changes, of a lidar that is named."""

OLD = "what they show is old, and objects are in the wrong place; check its driver and its connection"


class LidarCheck:
    """Counts each lidar's messages without points over a run, and those with the points of the one before.

    A simulator without noise sees a still scene the same again and again: a row of such messages counts once, unless
    another sensor sees changes for long. Those of a rig that is known to have moved are no part of frames.
    """

    def __init__(self, rig: Rig) -> None:
        self._lidars = {lidar.topic: lidar.name for lidar in rig.lidars}
        self._sensors = {*self._lidars, *(camera.topic for camera in rig.cameras)}
        self._last: dict[str, RawMessage] = {}  # By topic
        # By lidar: repeated messages in a row, and those of them while another sensor saw a change; the most of the
        # latter, and the frame with the last of them; frames with the first of some repeated ones
        self._row: dict[str, tuple[int, int]] = {}
        self._frozen: dict[str, tuple[int, int]] = {}
        self._repeated: dict[str, list[int]] = {}
        self._messages: Counter[str] = Counter()
        self._bad: Counter[str] = Counter()
        # by lidar: number of messages without points, and the first and last frame of them
        self._empty: dict[str, tuple[int, int, int]] = {}

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        bad, index = {drop.topic for drop in frame.drops if not drop.parts}, frame.bundle.index
        messages = {topic: one for topic, one in frame.bundle.messages.items() if topic in self._sensors}
        shown = [topic for topic in messages if topic in self._last and len(messages[topic].data) > HEADER_BYTES]
        is_same = {topic: repeats(messages[topic], self._last[topic]) for topic in shown}
        self._last |= messages
        for topic in messages:
            name = self._lidars.get(topic)
            if name is None:
                continue
            self._messages[name] += 1
            self._count_repeats(name, index, is_repeated=is_same.get(topic, False), is_still=all(is_same.values()))
            if topic in bad:
                self._bad[name] += 1
            elif not frame.combined.points_by_lidar.get(name, 0):
                count, first, _ = self._empty.get(name, (0, index, index))
                self._empty[name] = (count + 1, first, index)

    def _count_repeats(self, name: str, index: int, *, is_repeated: bool, is_still: bool) -> None:
        row, changing = self._row.get(name, (0, 0))
        if is_repeated and not row:
            self._repeated.setdefault(name, []).append(index)
        self._row[name] = (row + 1, changing + (not is_still)) if is_repeated else (0, 0)
        self._frozen[name] = max(self._frozen.get(name, (0, 0)), (self._row[name][1], index))

    @property
    def warnings(self) -> Iterator[RunWarning]:
        """One for each lidar whose messages cannot be decoded, have no point within range, or repeat the one before."""
        remedy = "the lidar may be covered, or its motor may stand still; else see combine.min_range_m and max_range_m"
        without = "messages without a single point in range"
        for name in (name for name in self._lidars.values() if self._messages[name]):
            total, (empty, first, last) = self._messages[name], self._empty.get(name, (0, 0, 0))
            if self._bad[name] == total:
                yield RunWarning(name, f"none of its {total} messages can be decoded", "-v lists the reasons")
            elif empty == total:
                yield RunWarning(name, f"{total} {without}", remedy)
            elif empty >= max(MIN_EMPTY, MIN_EMPTY_SHARE * total):
                yield RunWarning(name, f"{empty} of {total} {without}, in frames {first} to {last}", remedy)
            elif len(frames := self._repeated.get(name, [])) >= max(MIN_REPEATED, MIN_REPEATED_SHARE * total):
                finding = f"{len(frames)} of {total} messages have the points of the one before under a new stamp"
                yield RunWarning(name, f"{finding}, in frames {frames[0]} to {frames[-1]}", OLD)
            elif (frozen := self._frozen[name])[0] >= max(MIN_FROZEN, MIN_REPEATED_SHARE * total):
                finding = f"{frozen[0]} messages in a row, to frame {frozen[1]}, have the points of the one before"
                yield RunWarning(name, finding, f"unless it is a still scene of a simulator without noise, {OLD}")


MIN_GROUNDLESS, MIN_GROUNDLESS_SHARE = 2, 0.1
"""Minimum number and share of frames with points and without a ground that are told: other recordings have none."""


class GroundCheck:
    """Counts frames in whose clouds no ground is found."""

    def __init__(self, config: GroundConfig) -> None:
        self._is_sought, self._frames, self._groundless = config.enabled, 0, 0

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        if self._is_sought and frame.combined.counts.get("left", 0):
            self._frames += 1
            self._groundless += frame.combined.plane is None

    @property
    def warnings(self) -> Iterator[RunWarning]:
        """One if many frames have no ground: objects stand too high or too low there, and boxes are lost."""
        if self._groundless >= max(MIN_GROUNDLESS, MIN_GROUNDLESS_SHARE * self._frames):
            yield RunWarning(
                "ground",
                f"none was found in {self._groundless} of {self._frames} frames, and objects need it for their height",
                "if the clouds were recorded without their ground, take the lidar's own (topics.lidars); if its axes "
                "are not x forward and z up, give its pose in a rig file",
            )


MIN_UNKNOWN, MIN_UNKNOWN_SHARE = 3, 0.1
"""Minimum number and share of frames at whose time the rig's motion is not known that are told."""


class MotionCheck:
    """Counts frames at whose time the recorded motion of the rig is not known."""

    def __init__(self, rig: Rig, topics: Sequence[str]) -> None:
        self._topics, self._has_lidars, self._frames = ", ".join(topics), bool(rig.lidars), 0
        self._unknown: list[int] = []

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        bundle = frame.bundle
        self._frames += 1
        if bundle.motion is not None and not bundle.motion.covers(bundle.stamp_ns):
            self._unknown.append(bundle.index)

    @property
    def warnings(self) -> Iterator[RunWarning]:
        """One if it is not known in many frames: the odometry began late, ended early, paused or was recorded late."""
        count = len(self._unknown)
        if count >= max(MIN_UNKNOWN, MIN_UNKNOWN_SHARE * self._frames):
            span = f"in frames {self._unknown[0]} to {self._unknown[-1]}"
            remedy = "there, clouds are not compensated and tracks go by the clouds alone"
            if not self._has_lidars:
                remedy = "it counts as standing still there, so parked cars seem to drive: see --start and --duration"
            finding = f"the rig's motion is not known in {count} of {self._frames} frames, {span}"
            yield RunWarning(self._topics, finding, remedy)


MIN_IMAGES = 10
"""Minimum number of images of a camera that is named."""

MIN_SAME_SHARE = 0.9
"""Minimum share of images that are the same as the one before; the noise of a sensor makes every image another one."""

MIN_SAME_ROW = 10
"""Minimum number of images in a row that are the same as the one before, and at least `MIN_BLIND_SHARE` of them."""

MIN_SHOWN = 20
"""Minimum number of objects in the view of a camera without 2D boxes that is named, over all frames."""

MIN_BLIND_SHARE = 0.1
"""Minimum share of its images in a row without a 2D box."""

MIN_FOUND_SHARE, MIN_SOUGHT = 0.4, 50
"""Minimum share of the objects in its view that a camera has 2D boxes of, and minimum number of these objects.

Of cars of KITTI in daylight, it is 0.96; 0.63 with dirt on a third of the images, 0.34 with a sixteenth of the light.
"""

MIN_ANGLE = 0.15
"""Minimum diagonal of such an object, as a share of its distance: a car at 30 m."""


class CameraCheck:
    """Counts each camera's images that repeat the one before, and those without a 2D box where objects are."""

    def __init__(self, rig: Rig) -> None:
        self._cameras = [camera for camera in rig.cameras if camera.topic]
        self._last: dict[str, RawMessage] = {}
        # By camera: images, those that repeat the one before, objects in its view, and those with a 2D box
        self._images: Counter[str] = Counter()
        self._same: Counter[str] = Counter()
        # By camera: number of repeats in a row, now and at most, and the frame with the last of the most
        self._repeats: dict[str, tuple[int, int, int]] = {}
        self._objects: Counter[str] = Counter()
        self._found: Counter[str] = Counter()
        # By camera: number of images in a row without a 2D box, objects in view in these, the first and the last frame
        self._blind: dict[str, tuple[int, int, int, int]] = {}
        self._longest: dict[str, tuple[int, int, int, int]] = {}

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        for camera in self._cameras:
            name, message = camera.name, frame.bundle.messages.get(camera.topic)
            if message is None or not len(message.data):
                continue
            is_same = repeats(message, self._last.get(name))
            self._last[name] = message
            self._images[name] += 1
            boxes, index = frame.detections.cameras.get(name), frame.bundle.index
            self._same[name] += is_same
            row, longest, end = self._repeats.get(name, (0, 0, 0))
            row = row + 1 if is_same else 0
            self._repeats[name] = (row, row, index) if row > longest else (row, longest, end)
            if boxes is None or not camera.fit.is_used:
                continue
            shown = _shown_rows(frame, name)
            self._objects[name] += len(shown)
            self._found[name] += int(np.isin(shown, frame.matches[name].pairs[:, 0]).sum())
            if len(boxes):
                self._blind.pop(name, None)
                continue
            images, objects, first, _ = self._blind.get(name, (0, 0, index, index))
            self._blind[name] = images + 1, objects + len(shown), first, index
            self._longest[name] = max(self._longest.get(name, (0, 0, 0, 0)), self._blind[name])

    @property
    def warnings(self) -> Iterator[RunWarning]:
        """One for each camera whose images are the same for long, or that has no 2D box of many objects."""
        for camera in self._cameras:
            name, images = camera.name, self._images[camera.name]
            exclude = f"leave it out with --set topics.exclude=[{camera.topic}]"
            _, row, end = self._repeats.get(name, (0, 0, 0))
            is_nearly_all = images >= MIN_IMAGES and self._same[name] >= MIN_SAME_SHARE * (images - 1)
            if is_nearly_all or row >= max(MIN_SAME_ROW, MIN_BLIND_SHARE * images):
                span = f"of {images} images are" if is_nearly_all else f"images in a row, to frame {end}, are"
                finding = f"{self._same[name] if is_nearly_all else row} {span} the same as the one before"
                yield RunWarning(name, finding, f"its driver may repeat an image, or it is covered; {exclude}")
                continue
            blind, objects, first, last = self._longest.get(name, (0, 0, 0, 0))
            found, of_all = self._found[name], self._objects[name]
            remedy = f"it may be covered or too dark, or the network may not fit its images; {exclude}"
            if blind >= max(MIN_IMAGES, MIN_BLIND_SHARE * images) and objects >= MIN_SHOWN:
                span = f" in a row, in frames {first} to {last}," if blind < images else ","
                finding = f"no 2D box in {blind} images{span} with {objects} objects in its view"
                yield RunWarning(name, finding, remedy)
            elif of_all >= MIN_SOUGHT and found < MIN_FOUND_SHARE * of_all:
                finding = f"2D boxes of {found} of {of_all} objects in its view"
                yield RunWarning(name, finding, f"its calibration may be wrong, {remedy}")


def _shown_rows(frame: FrameResult, name: str) -> I64:
    """(N,) hypotheses of the objects that are large enough in the image of a camera, without those by tracks alone."""
    objects, view = frame.fused.objects, frame.views[name]
    centers = view.T_camera_site.apply(objects.centers)
    pixels, valid = view.model.project(centers)
    inside = ((pixels >= 0) & (pixels <= (view.model.width_px, view.model.height_px))).all(1)
    is_large = np.linalg.norm(objects.sizes, axis=1) >= MIN_ANGLE * np.linalg.norm(centers, axis=1)
    return np.asarray(frame.fused.rows[valid & inside & is_large & (frame.fused.rows >= 0)])
