"""Decodes video topics before synchronisation, so that their messages are images from here on.

Every message of a topic is decoded in order, even if no frame uses it, because later images depend on it. The output is
one JPEG per message, so the queues of synchronisation hold no decoded images. A message that gave no image still takes
part in synchronisation, so that the other sensors' frames go on; it is then removed from its frame and counted.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import Missing, SensorBundle
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.recording import Recording
from lidcam.readers.video.packets import AFTER_DAMAGE, BEFORE_KEY_FRAME, VIDEO, read_packet

if TYPE_CHECKING:
    from lidcam.readers.video.decoder import VideoDecoder

LOOK_BACK_NS = 10_000_000_000
"""Time before a window in which the last key frame is sought: many encoders send one every 250 images or sooner."""

MAX_HELD_BYTES = 64 << 20
"""Memory for one topic while its last key frame is sought."""

MESSAGE_BYTES = 400
"""Memory of a message besides its data."""

MAX_SOUGHT = 1000
"""Messages that are decoded in search of the first image."""


def video_topics(recording: Recording, topics: Collection[str]) -> tuple[str, ...]:
    """The `topics` that hold video and can be read."""
    video = {info.topic for info in recording.topics if info.msgtype in VIDEO and not info.unreadable}
    return tuple(topic for topic in topics if topic in video)


def first_image_size(
    messages: Iterable[RawMessage], *, limits: RecordingLimits = DEFAULT_LIMITS
) -> tuple[int, int] | None:
    """(width, height) in pixels of a video topic's first image; None if the first messages give none."""
    decoder: VideoDecoder | None = None
    for message in islice((m for m in messages if m.channel.msgtype in VIDEO), MAX_SOUGHT):
        decoder = decoder or _decoder(message.topic, limits)
        for image in decoder.add_message(message):
            if not image.problem:
                height, width = decode_any_image(image, limits=limits).rgb.shape[:2]
                return width, height
    return None


class VideoStreams:
    """The video topics of one pass over a recording."""

    def __init__(self, topics: Iterable[str], *, limits: RecordingLimits = DEFAULT_LIMITS) -> None:
        self._decoders = {topic: _decoder(topic, limits) for topic in topics}
        self._looked_back = False

    def look_back(self, recording: Recording, start_ns: int) -> None:
        """Decode from the last key frame before `start_ns` on, which the images after it depend on."""
        self._looked_back = True
        if not self._decoders:
            return
        held: dict[str, list[RawMessage]] = {}
        size: dict[str, int] = {}
        for message in recording.messages([*self._decoders], start_ns=start_ns - LOOK_BACK_NS, stop_ns=start_ns):
            topic = message.topic
            if message.channel.msgtype not in VIDEO:
                continue
            if _is_key(message):
                held[topic], size[topic] = [], 0
            if topic in held:
                held[topic].append(message)
                size[topic] += len(message.data) + MESSAGE_BYTES
                if size[topic] > MAX_HELD_BYTES:
                    self._take_in(held[topic])
                    held[topic], size[topic] = [], 0
        for messages in held.values():
            self._take_in(messages)

    def _take_in(self, messages: Iterable[RawMessage]) -> None:
        for message in messages:
            self._decoders[message.topic].add_message(message, show=False)

    def decoded(self, messages: Iterable[RawMessage]) -> Iterator[RawMessage]:
        """All messages, those of video topics as images."""
        for message in messages:
            decoder = self._decoders.get(message.topic)
            if decoder is None or message.channel.msgtype not in VIDEO:
                yield message
            else:
                yield from decoder.add_message(message)
        for decoder in self._decoders.values():
            yield from decoder.flush()

    def without_blanks(
        self, bundles: Iterable[SensorBundle], *, on_drop: Callable[[Drop], None], on_bad: Callable[[Drop], None]
    ) -> Iterator[SensorBundle]:
        """The bundles, of messages from `decoded`, with their packets and without the messages that gave no image.

        Those before the first key frame go to `on_drop`, as most recordings begin between two; all others to `on_bad`.
        """
        for bundle in bundles:
            blank = [m for topic in self._decoders if (m := bundle.messages.get(topic)) is not None and m.problem]
            if not blank:
                yield self._with_packets(bundle)
                continue
            dropped_before = Counter(bundle.dropped_before)
            for message in blank:
                drop = self._drop(message)
                dropped_before[drop.topic, drop.reason] += 1
                (on_drop if drop.reason == BEFORE_KEY_FRAME else on_bad)(drop)
            topics = {message.topic for message in blank}
            kept = {topic: message for topic, message in bundle.messages.items() if topic not in topics}
            missing = {**bundle.missing, **dict.fromkeys(sorted(topics), Missing.NO_IMAGE)}
            yield self._with_packets(
                replace(bundle, messages=kept, missing=missing, dropped_before=dict(dropped_before))
            )

    def _with_packets(self, bundle: SensorBundle) -> SensorBundle:
        taken = {
            topic: decoder.kept.take(bundle.messages[topic])
            for topic, decoder in self._decoders.items()
            if topic in bundle.messages
        }
        return replace(bundle, video={topic: part for topic, part in taken.items() if part}) if taken else bundle

    def _drop(self, message: RawMessage) -> Drop:
        if message.problem == BEFORE_KEY_FRAME:
            detail = f"none in the {LOOK_BACK_NS // 10**9} s before --start" if self._looked_back else ""
            return Drop(message.topic, message.stamp_ns, BEFORE_KEY_FRAME, detail)
        if message.problem == AFTER_DAMAGE:
            return Drop(message.topic, message.stamp_ns, AFTER_DAMAGE)
        return Drop(message.topic, message.stamp_ns, "cannot be decoded", message.problem)


def _decoder(topic: str, limits: RecordingLimits) -> "VideoDecoder":
    from lidcam.readers.video.decoder import VideoDecoder  # needs PyAV, which is optional

    return VideoDecoder(topic, limits=limits)


def _is_key(message: RawMessage) -> bool:
    try:
        return read_packet(message).is_key
    except MessageError:
        return False
