"""Stamps and contents of topics that are compared with one another.

Nodes hand on the stamp of what they worked on, so clouds, or images, of equal stamps are candidates.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.recording import Recording
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.sensor_topics import IMAGE

LOOK_NS = 1_500_000_000
"""Log time before and after the first message of the topic that begins last, in which stamps are compared."""

STAMP_NS = 1_000
"""Largest difference of equal stamps: nodes that keep times as float64 seconds round them."""

ENOUGH = 6
"""Number of messages of each topic after which no more are read."""

LAST = 3
"""Number of the sensor's last messages of which a message with a stamp of its own may have been made."""

MAX_COMPARED = 200
"""Largest number of topics that are compared; a vehicle with eight lidars and all of Autoware has eighty of clouds."""

MIN_EQUAL_SHARE = 0.8
"""Smallest share of a topic's stamps that the sensor's topic has, too."""


class Seen(NamedTuple):
    """The messages of a topic over a few seconds."""

    stamps_ns: I64  # (N,) in order
    log_ns: I64  # (N,) times at which they were recorded

    @property
    def delay_ns(self) -> float:
        """Median time between stamp and recording; infinite without messages."""
        return float(np.median(self.log_ns - self.stamps_ns)) if len(self.stamps_ns) else np.inf

    def shared_with(self, sensor: "Seen") -> list[tuple[int, int]]:
        """Log times of its messages and of the sensor's of equal stamps."""
        if not len(sensor.stamps_ns):
            return []
        near = np.searchsorted(sensor.stamps_ns, self.stamps_ns - STAMP_NS).clip(max=len(sensor.stamps_ns) - 1)
        equal = (np.abs(sensor.stamps_ns[near] - self.stamps_ns) <= STAMP_NS) & (self.stamps_ns != 0)
        return list(zip(self.log_ns[equal].tolist(), sensor.log_ns[near[equal]].tolist(), strict=True))

    def recorded_after(self, sensor: "Seen") -> list[tuple[int, int]]:
        """Log times of a message, and of each of the last of the sensor's that were recorded before it."""
        log_ns = int(np.sort(self.log_ns)[len(self.log_ns) // 2])
        before = np.sort(sensor.log_ns[sensor.log_ns < log_ns])
        return [(log_ns, one) for one in before[: -LAST - 1 : -1].tolist()]


class Pair(NamedTuple):
    """Two topics with messages of one stamp: one that may have been made of the other, a sensor's."""

    topic: str
    sensor: str  # Or what was made of a sensor's
    log_ns: int  # When the message of `topic` was recorded
    sensor_log_ns: int  # When that of `sensor` was
    other_log_ns: int | None  # When another message of `sensor` was
    is_stamped: bool  # Whether their stamps are equal; else they were recorded one after the other


class Contents:
    """The stamps of some topics of a recording, all of a kind, and the decoded content of single messages."""

    def __init__(
        self,
        recording: Recording,
        topics: Sequence[str],
        kind: frozenset[str],
        first: FirstMessages,
        decode: Callable[[RawMessage], Any],
    ) -> None:
        self._recording, self._kind, self._decode = recording, kind, decode
        self._decoded: dict[tuple[str, int], Any] = {}
        begin_ns = {topic: first.log_time_ns(topic, kind) for topic in topics}
        self._seen = _seen(recording, {topic: at_ns for topic, at_ns in begin_ns.items() if at_ns is not None})

    def delay_ns(self, topic: str) -> float:
        """Median time between stamp and recording; infinite where that is not known."""
        return self._seen[topic].delay_ns if topic in self._seen else np.inf

    def sources(self, ordered: Iterable[str], is_made_of: Callable[[Pair], bool | None]) -> dict[str, str]:
        """The topic that each one was made of, empty for sensors; the rawest come first.

        `is_made_of` is asked for other messages of the pair of topics where it returns None: they say nothing.
        """
        sources: dict[str, str] = {}
        for topic in ordered:
            before = sorted(sources, key=lambda one: sources[one] != "")  # sensors first
            found = self._source(topic, before, is_made_of)
            sources[topic] = sources.get(found) or found
        return sources

    def _source(self, topic: str, sensors: Sequence[str], is_made_of: Callable[[Pair], bool | None]) -> str:
        for sensor, pairs in self.pairs(topic, sensors).items():
            for pair in pairs:
                with suppress(MessageError):  # such messages are dropped, and counted, where they are used
                    is_made = is_made_of(pair)
                    if is_made:
                        return sensor
                    if is_made is not None and pair.is_stamped:
                        break
        return ""

    def pairs(self, topic: str, sensors: Sequence[str]) -> dict[str, list[Pair]]:
        """Messages of a topic beside those of each of the sensors that it may have been made of."""
        seen = self._seen.get(topic)
        if seen is None or not len(seen.stamps_ns):
            return {}
        shared = {one: seen.shared_with(self._seen[one]) for one in sensors if one in self._seen}
        equal = {log_ns for pairs in shared.values() for log_ns, _ in pairs}
        is_stamped = len(equal) >= max(MIN_EQUAL_SHARE * np.count_nonzero(seen.stamps_ns), 1)
        if not is_stamped:
            shared = {one: seen.recorded_after(self._seen[one]) for one in shared}
        found: dict[str, list[Pair]] = {}
        for one, pairs in shared.items():
            other_ns, middle = pairs[0][1] if len(pairs) > 1 else None, len(pairs) // 2
            in_turn = (*pairs[middle:], *pairs[:middle])
            found[one] = [Pair(topic, one, log_ns, sensor_ns, other_ns, is_stamped) for log_ns, sensor_ns in in_turn]
        return found

    def at(self, topic: str, log_ns: int) -> Any:
        """The decoded message of a topic that was recorded at a time; raises MessageError if it cannot be decoded."""
        if (topic, log_ns) not in self._decoded:
            messages = self._recording.messages([topic], start_ns=log_ns, stop_ns=log_ns + 1)
            message = next((one for one in messages if one.channel.msgtype in self._kind), None)
            if message is None:  # damage that hides it at the second reading
                raise MessageError(f"{topic}: its message of log time {log_ns} ns is gone")
            self._decoded[topic, log_ns] = self._decode(message)
        return self._decoded[topic, log_ns]


def _seen(recording: Recording, begin_ns: Mapping[str, int]) -> dict[str, Seen]:
    """Some messages of topics around the time at which the last of them begins."""
    if not 2 <= len(begin_ns) <= MAX_COMPARED:
        return {}
    at_ns = max(begin_ns.values())
    found: dict[str, list[tuple[int, int]]] = {topic: [] for topic in begin_ns}
    for message in recording.messages(begin_ns, start_ns=at_ns - LOOK_NS, stop_ns=at_ns + LOOK_NS):
        rows = found[message.topic]
        rows.append((message.stamp_ns, message.log_time_ns))
        if len(rows) == ENOUGH and all(len(others) >= ENOUGH for others in found.values()):
            break
    times = {topic: np.array(sorted(rows), np.int64).reshape(-1, 2) for topic, rows in found.items()}
    return {topic: Seen(rows[:, 0], rows[:, 1]) for topic, rows in times.items()}


PATTERN_PX = 320, 240
"""Size at which the patterns of images are compared."""

MIN_PATTERN, MIN_COPY = 0.8, 0.98
"""Smallest correlations of an image's pattern with that of the same image, drawn on or resized, and of its copy."""


def image_sources(
    recording: Recording,
    ordered: Sequence[str],
    first: FirstMessages,
    limits: RecordingLimits,
    *,
    has_info: Callable[[str], bool],
) -> dict[str, str]:
    """The topic that each topic of images was made of; empty for the rawest of each camera.

    Rawest are those with a calibration of their own, the largest, the earliest received, then in the order given.
    `has_info`: whether a topic has a CameraInfo of its own.
    """

    def pattern(message: RawMessage) -> F64:
        return _pattern(decode_any_image(message, limits=limits).rgb)

    contents = Contents(recording, ordered, IMAGE, first, pattern)

    def rawness(topic: str) -> tuple[bool, int, float]:
        width, height = first.image_size(topic, IMAGE) or (0, 0)
        return not has_info(topic), -width * height, contents.delay_ns(topic)

    def is_made_of(pair: Pair) -> bool:
        frame, other = first.frame(pair.topic, IMAGE), first.frame(pair.sensor, IMAGE)
        if frame != other and (has_info(pair.topic) or (frame and other)):  # cameras that are triggered together
            return False
        if pair.is_stamped and has_info(pair.sensor) and not has_info(pair.topic) and other and frame in {"", other}:
            return True  # nodes that draw often leave the frame out, drivers do not
        made, image = contents.at(pair.topic, pair.log_ns), contents.at(pair.sensor, pair.sensor_log_ns)
        is_of_size = first.image_size(pair.topic, IMAGE) == first.image_size(pair.sensor, IMAGE)
        least = MIN_COPY if has_info(pair.topic) and is_of_size else MIN_PATTERN  # stereo cameras share a frame
        return float((made * image).sum()) >= least

    return contents.sources(sorted(ordered, key=rawness), is_made_of)


def _pattern(rgb: Any) -> F64:
    """(240, 320) what an image shows apart from its brightness, of unit length; zero where it shows nothing."""
    import cv2

    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(gray, PATTERN_PX, interpolation=cv2.INTER_AREA).astype(np.float64)
    pattern = small - cv2.blur(small, (15, 15))
    return np.asarray(pattern / max(float(np.linalg.norm(pattern)), 1e-9), np.float64)
