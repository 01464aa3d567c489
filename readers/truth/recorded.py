"""Truth from recorded topics: boxes in space, and boxes of what images show.

The topics are read in one pass, as far as the objects are needed; boxes of images are read along with them.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.ros.vision_numbers import IMAGE_PIXELS
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes2D, TruthBoxes3D
from lidcam.readers.messages.detections import decode_detections2d, decode_detections3d
from lidcam.readers.messages.objects import ObjectClasses
from lidcam.readers.notes import Notes
from lidcam.readers.recording import Recording
from lidcam.readers.truth.boxes import class_ids_of
from lidcam.readers.truth.moment import STEP_BACK_NS, Moment, class_names_of, moment_of, object_ids, total
from lidcam.readers.truth.source import TruthSource
from lidcam.readers.truth.timeline import Timeline
from lidcam.readers.truth.topics import TruthTopics

READ_ALONG_NS = 1_000_000_000
"""Longest delay of the boxes of images behind the objects of their time."""

MAX_OFF_NS = 20_000_000
"""Largest difference of the stamps of an image and of its truth: clocks of cameras are corrected by as much."""

MAX_IMAGES = 1000
"""Largest number of images of one camera whose boxes are kept."""


class RecordedTruth(TruthSource):
    """Truth of the topics of a recording; see `TruthSource`.

    The recording is read as far as it is needed and not closed. The optical frames or names of `cameras`, the result's,
    say whose images were labelled.
    """

    def __init__(
        self, recording: Recording, topics: TruthTopics, cameras: Sequence[CameraSensor], config: Config
    ) -> None:
        self._topics, self._limits = topics, config.limits
        self._class_ids = config.class_id_of_label
        self._notes = Notes()
        self._wanted = topics.objects
        if config.evaluate.truth_time == "points":
            self._wanted = topics.when_measured or topics.objects
            if not topics.when_measured:
                missing = f"no {topics.objects}_when_measured was recorded"
                self._notes.add_note(f"{missing}: compared at the stamp of each frame")
        self._timelines = {topic: Timeline() for topic in dict.fromkeys((self._wanted, topics.objects))}
        self._images = {camera.name: _Images() for camera in cameras} if topics.visible else {}
        self._camera_of_frame = {camera.T_camera_site.dst: camera.name for camera in cameras}
        self._messages = recording.messages([*self._timelines, *topics.visible])
        self._latest_ns = 0
        names = ", ".join(path.name for path in recording.paths)
        self.description = f"{self._wanted} of {names} ({topics.why})"

    @property
    def notes(self) -> tuple[str, ...]:
        """See `TruthSource`."""
        notes = []
        for topic, timeline in self._timelines.items():
            if timeline.nearest:
                notes.append(
                    f"{topic}: its objects have no ids of their own: taken as the nearest message has them, up to "
                    f"{timeline.farthest_ns / 1e6:.1f} ms off"
                )
        return (*self._notes.lines(), *notes)

    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        """See `TruthSource`."""
        del frame
        self._read(stamp_ns)
        moment = self._timelines[self._wanted].at(stamp_ns)
        return None if moment is None else moment.boxes

    def moment(self, stamp_ns: int, *, frame: int) -> Moment | None:
        """See `TruthSource`."""
        del frame
        self._read(stamp_ns)
        return self._timelines[self._topics.objects].at(stamp_ns)

    def in_image(self, camera: str, stamp_ns: int, *, frame: int) -> TruthBoxes2D | None:
        """See `TruthSource`."""
        del frame
        if camera not in self._images:
            return None
        self._read(stamp_ns)
        return self._images[camera].at(stamp_ns)

    def _read(self, stamp_ns: int) -> None:
        """Read on until the objects of a time are known, and the boxes of its images."""
        self._latest_ns = max(self._latest_ns, stamp_ns)
        until_ns = stamp_ns + (READ_ALONG_NS if self._images else 0)
        while not all(timeline.reaches(until_ns) for timeline in self._timelines.values()):
            message = next(self._messages, None)
            if message is None:
                return
            self._take(message)
            for timeline in self._timelines.values():
                timeline.forget(self._latest_ns - STEP_BACK_NS)

    def _take(self, message: RawMessage) -> None:
        try:
            if message.topic not in self._timelines:
                self._take_image(message)
                return
            found = decode_detections3d(message, limits=self._limits)
        except MessageError as err:
            self._notes.add_note(f"messages of {message.topic} that are not used", str(err))
            return
        for reason, count in found.unused.items():
            self._notes.add_note(f"{message.topic}: objects that are not used, {reason}", count=count)
        moment = moment_of(found, self._class_ids)
        if message.topic == self._wanted:
            for label in moment.boxes.labels[moment.boxes.class_ids == UNKNOWN].tolist():
                self._notes.add_note(f"{message.topic}: objects of class {label!r}, which is no class of the settings")
        self._timelines[message.topic].add_moment(moment)

    def _take_image(self, message: RawMessage) -> None:
        classes = ObjectClasses(self._class_ids)
        found = decode_detections2d(message, classes, other_class_id=UNKNOWN, limits=self._limits)
        name = message.topic.split("/")[-2]
        images = self._images.get(self._camera_of_frame.get(found.boxes.frame_id, name))
        if images is None:
            self._notes.add_note(f"images of {message.topic}, a camera that the result does not have")
            return
        n = len(found.boxes)
        shown = TruthBoxes2D(
            message.stamp_ns,
            found.boxes.xyxy,
            class_ids_of(found.labels.tolist(), self._class_ids),
            class_names_of(found.labels),
            object_ids(found.ids, found.counts),
            total(found.counts, IMAGE_PIXELS, n),
            np.zeros(n, np.bool_),
        )
        images.add_boxes(shown, self._latest_ns - STEP_BACK_NS)


class _Images:
    """The boxes in the images of one camera, in the order of their stamps."""

    def __init__(self) -> None:
        self._kept: deque[TruthBoxes2D] = deque()

    def add_boxes(self, shown: TruthBoxes2D, before_ns: int) -> None:
        """Take the boxes of an image; forget those of images before a time, or all where time steps back."""
        while self._kept and (self._kept[0].stamp_ns < before_ns or len(self._kept) >= MAX_IMAGES):
            self._kept.popleft()
        if not self._kept or shown.stamp_ns > self._kept[-1].stamp_ns:
            self._kept.append(shown)
        elif shown.stamp_ns < self._kept[-1].stamp_ns - STEP_BACK_NS:
            self._kept = deque([shown])

    def at(self, stamp_ns: int) -> TruthBoxes2D | None:
        """The boxes of the image of a time; None if there are none near it."""
        stamps = [shown.stamp_ns for shown in self._kept]
        row = bisect_left(stamps, stamp_ns)
        near = [at for at in (row - 1, row) if 0 <= at < len(stamps) and abs(stamps[at] - stamp_ns) <= MAX_OFF_NS]
        return self._kept[min(near, key=lambda at: abs(stamps[at] - stamp_ns))] if near else None
