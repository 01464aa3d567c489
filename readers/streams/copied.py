"""Recorded messages that are copied to the output, taken out of the stream and handed on with the frames."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.messages import Drop, RawMessage, time_fault
from lidcam.pipeline.core.ros.vision_numbers import CLASS_OF_NUMBER
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.readers.messages.detections import decode_detections3d
from lidcam.readers.messages.to_ros2 import name_of_number, to_ros2
from lidcam.readers.recording import Recording

MARGIN_NS = 2_000_000_000
"""Margin of a window on both sides, whose messages are copied, too: truth is interpolated at its first and last frame,
and may be recorded late."""

MESSAGE_BYTES = 500
"""Bytes that a message takes in memory beside its data."""

NOT_CONVERTED = "cannot be copied"
TOO_MANY = "more than limit_scale allows waited for a frame"


class CopiedMessages:
    """The messages of some topics, as CDR, each handed on with the first frame that was not recorded before it.

    Messages wait only while no frame is complete, and then not more than `limits` allow: memory does not grow with the
    recording. Which message goes with which frame depends on the recording alone.

    `classes` name the class numbers of ROS 1; the boxes of the topics `drawn` are drawn, too. `on_drop` gets the
    messages that waited in vain, `on_bad` those that cannot be converted.
    """

    def __init__(
        self,
        topics: Sequence[str],
        classes: Sequence[ClassPrior] = (),
        *,
        drawn: Collection[str] = (),
        limits: RecordingLimits = DEFAULT_LIMITS,
        on_drop: Callable[[Drop], None] = lambda _: None,
        on_bad: Callable[[Drop], None] = lambda _: None,
    ) -> None:
        self.topics, self._drawn = tuple(topics), frozenset(drawn)
        self._name_of = lru_cache(maxsize=4096)(partial(name_of_number, classes=classes))
        self._limits, self._on_drop, self._on_bad = limits, on_drop, on_bad
        self._due: list[RawMessage] = []
        self._waiting: deque[RawMessage] = deque()
        self._bytes = 0

    def read_ahead(self, recording: Recording, start_ns: int) -> None:
        """Take the messages that were recorded just before a window."""
        self._read(recording, start_ns - MARGIN_NS, start_ns)

    def tap(self, messages: Iterable[RawMessage], others: Collection[str]) -> Iterator[RawMessage]:
        """Take the messages of the topics; those of `others` pass on."""
        for message in messages:
            if message.topic in self.topics:
                self._take(message)
            if message.topic in others:
                yield message

    def handed_on(
        self, bundles: Iterable[SensorBundle], recording: Recording, stop_ns: int | None
    ) -> Iterator[SensorBundle]:
        """The bundles with the messages to copy; the last one has those recorded after it, and just after a window."""
        last: SensorBundle | None = None
        for bundle in bundles:
            if last is not None:
                yield last
            last = self._with(bundle, self._until(bundle.log_time_ns))
        if last is not None:
            if stop_ns is not None:
                self._read(recording, stop_ns, stop_ns + MARGIN_NS)
            yield self._with(last, (*last.copied, *self._due, *self._waiting))

    def _with(self, bundle: SensorBundle, copied: tuple[RawMessage, ...]) -> SensorBundle:
        drawn = (self._true_boxes(message) for message in copied if message.topic in self._drawn)
        return replace(bundle, copied=copied, truth=tuple(boxes for boxes in drawn if boxes is not None))

    def _true_boxes(self, message: RawMessage) -> TrueBoxes | None:
        """The boxes of a message; None if it cannot be drawn: it is copied all the same, and an evaluation says so."""
        try:
            found = decode_detections3d(message, limits=self._limits)
        except MessageError:
            return None
        if time_fault(message.stamp_ns):
            return None
        labels = [CLASS_OF_NUMBER.get(label, label) for label in found.labels.tolist()]
        times = message.stamp_ns, message.log_time_ns
        return TrueBoxes(message.topic, *times, found.frame_id, found.centers, found.sizes, found.yaws, labels)

    def _read(self, recording: Recording, start_ns: int, stop_ns: int) -> None:
        if self.topics:
            for message in recording.messages(self.topics, start_ns=start_ns, stop_ns=stop_ns):
                self._take(message)

    def _take(self, message: RawMessage) -> None:
        try:
            copied = to_ros2(message, self._name_of, limits=self._limits)
        except MessageError as err:
            self._on_bad(Drop(message.topic, message.stamp_ns, NOT_CONVERTED, str(err)))
            return
        if self._bytes + _memory_of(copied) > self._limits.max_waiting_bytes:
            self._on_drop(Drop(message.topic, message.stamp_ns, TOO_MANY))
            return
        if self._waiting and copied.log_time_ns < self._waiting[-1].log_time_ns:  # the recorder's time jumps back
            self._due += self._waiting
            self._waiting.clear()
        self._waiting.append(copied)
        self._bytes += _memory_of(copied)

    def _until(self, log_time_ns: int) -> tuple[RawMessage, ...]:
        """The messages recorded up to a time, or before the recorder's time jumped back; it no longer waits."""
        while self._waiting and self._waiting[0].log_time_ns <= log_time_ns:
            self._due.append(self._waiting.popleft())
        found, self._due = tuple(self._due), []
        self._bytes -= sum(map(_memory_of, found))
        return found


def _memory_of(message: RawMessage) -> int:
    return len(message.data) + MESSAGE_BYTES
