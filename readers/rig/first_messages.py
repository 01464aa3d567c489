"""The first message of each topic that can be decoded, which has the sensor's frame and the size of its images.

Of CameraInfo it is the first with a calibration: drivers send empty ones until theirs is loaded.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits, VelodyneConfig
from lidcam.readers.messages.compressed_cloud import COMPRESSED_CLOUDS, unpack_cloud
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.image import COMPRESSED_IMAGE
from lidcam.readers.messages.image_header import image_size
from lidcam.readers.messages.pointcloud import CUSTOM, POINT_CLOUD, parse_livox, read_pointcloud
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.messages.tf import clean_frame
from lidcam.readers.ouster.decoder import decode_ouster
from lidcam.readers.ouster.packets import SWEEP
from lidcam.readers.recording import Recording
from lidcam.readers.rig.sensor_topics import CAMERA_INFO
from lidcam.readers.velodyne.decoder import VelodyneDecoders
from lidcam.readers.velodyne.scan import SCAN
from lidcam.readers.video.packets import VIDEO, read_packet
from lidcam.readers.video.streams import first_image_size

MAX_TRIES = 20
"""Largest number of messages tried per topic: a recording may begin with a few damaged ones."""


class _First(NamedTuple):
    """A decoded message without its largest field, its frame, and the size of its image in pixels, if that is known."""

    content: Any
    frame_id: str
    size_px: tuple[int, int] | None
    stamp_ns: int
    log_time_ns: int


class FirstMessages:
    """Reads the start of topics, each only once; errors in the settings of a Velodyne's packets are raised."""

    def __init__(
        self, recording: Recording, velodyne: VelodyneConfig | None = None, *, limits: RecordingLimits = DEFAULT_LIMITS
    ) -> None:
        self._recording = recording
        self._limits = limits
        self._velodyne = VelodyneDecoders(velodyne or VelodyneConfig())
        self._found: dict[tuple[str, str], _First | MessageError] = {}

    def decoded(self, topic: str, msgtypes: Collection[str]) -> Any:
        """The first message of `topic` with one of `msgtypes`, decoded, without its points, pixels or packets.

        Raises:
            MessageError: none of the first messages can be decoded; quotes the first error.
        """
        found = self._first(topic, msgtypes)
        if isinstance(found, MessageError):
            raise found
        return found.content

    def missing(self, topic: str, msgtypes: Collection[str]) -> bool:
        """Whether none of the topic's first messages can be decoded."""
        return self._usable(topic, msgtypes) is None

    def frame(self, topic: str, msgtypes: Collection[str]) -> str:
        """The frame of a topic's messages; empty if they name none or cannot be decoded."""
        return found.frame_id if (found := self._usable(topic, msgtypes)) else ""

    def log_time_ns(self, topic: str, msgtypes: Collection[str]) -> int | None:
        """When the first message that can be decoded was recorded; None if none can."""
        return found.log_time_ns if (found := self._usable(topic, msgtypes)) else None

    def delay_ns(self, topic: str, msgtypes: Collection[str]) -> int | None:
        """Log time minus stamp of the first message that can be decoded; None if none can, or its stamp is 0."""
        found = self._usable(topic, msgtypes)
        return found.log_time_ns - found.stamp_ns if found and found.stamp_ns else None

    def image_size(self, topic: str, msgtypes: Collection[str]) -> tuple[int, int] | None:
        """(width, height) of the topic's first image or cloud, in pixels or points; None if unknown."""
        found = self._usable(topic, msgtypes)
        if found is None:
            return None
        if getattr(found.content, "__msgtype__", "") in VIDEO and found.size_px is None:
            size = first_image_size(self._recording.messages([topic]), limits=self._limits)
            self._found[topic, min(msgtypes)] = found._replace(size_px=size)
            return size
        return found.size_px

    def cloud(self, message: RawMessage) -> PointCloud:
        """The points of a message, also of packets, with the intensities that nodes hand on."""
        if message.channel.msgtype == SCAN:
            return self._velodyne[message.topic](message)
        cloud: PointCloud = decode_as("cloud", message, limits=self._limits, calibrated=False)
        return cloud

    def _usable(self, topic: str, msgtypes: Collection[str]) -> _First | None:
        found = self._first(topic, msgtypes)
        return None if isinstance(found, MessageError) else found

    def _first(self, topic: str, msgtypes: Collection[str]) -> _First | MessageError:
        key = (topic, min(msgtypes))
        if key not in self._found:
            self._found[key] = self._read(topic, msgtypes)
        return self._found[key]

    def _read(self, topic: str, msgtypes: Collection[str]) -> _First | MessageError:
        fault: MessageError | None = None
        empty: _First | None = None
        tried = 0
        for message in self._recording.messages([topic]):
            if message.channel.msgtype not in msgtypes:
                continue
            tried += 1
            try:
                if message.channel.msgtype == SCAN:  # the model may be unknown
                    self._velodyne[topic](message)
                if message.channel.msgtype == SWEEP:  # its JSON may be another one's
                    decode_ouster(message, limits=self._limits)
                if message.channel.msgtype in VIDEO:
                    read_packet(message)
                found = _first_of(message, self._limits)
                if msgtypes != CAMERA_INFO or any(np.any(getattr(found.content, name, 0)) for name in "kpKP"):
                    return found
                empty = empty or found
            except MessageError as err:
                fault = fault or err
            if tried == MAX_TRIES:
                break
        if empty:
            return empty
        reason = str(fault or "it has none").removeprefix(f"{topic}: ")
        return MessageError(f"{topic}: none of its first {tried} messages can be decoded: {reason}")


@decoder
def _first_of(message: RawMessage, limits: RecordingLimits) -> _First:
    """A message without its largest field: a rig may have hundreds of topics with large messages."""
    msgtype = message.channel.msgtype
    if msgtype in CUSTOM:  # points of which each would be an object
        livox = parse_livox(message)
        none = replace(livox, points=livox.points[:0])
        return _First(none, livox.frame_id, (len(livox.points), 1), message.stamp_ns, message.log_time_ns)
    # also of a PointCloud each point would be an object
    read = unpack_cloud if msgtype in COMPRESSED_CLOUDS else read_pointcloud if msgtype == POINT_CLOUD else deserialize
    content: Any = read(message, limits=limits)
    size = (int(content.width), int(content.height)) if hasattr(content, "width") else None
    if msgtype in VIDEO:
        size = None  # known once an image of it is decoded
    elif msgtype == COMPRESSED_IMAGE:
        size = image_size(content.data.tobytes())
    for large in ("data", "packets"):
        if hasattr(content, large):
            object.__setattr__(content, large, ())
    frame = clean_frame(getattr(content, "header", content).frame_id)
    return _First(content, frame, size, message.stamp_ns, message.log_time_ns)
