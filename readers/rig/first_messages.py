"""The first message of each topic that can be decoded, which has the sensor's frame and the size of its images."""

from collections.abc import Collection
from typing import Any

from pipeline.core.errors import MessageError
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig, VelodyneConfig
from readers.messages.deserialize import deserialize
from readers.messages.image import COMPRESSED_IMAGE
from readers.messages.image_header import image_size
from readers.messages.tf import clean_frame
from readers.recording import Recording
from readers.velodyne.decoder import VelodyneDecoders
from readers.velodyne.scan import SCAN
from readers.video.packets import VIDEO, read_packet
from readers.video.streams import first_image_size

__all__ = ["FirstMessages"]

TRIES = 20
"""Messages that are tried per topic: a recording may begin with a few damaged ones."""


class FirstMessages:
    """Reads the start of topics, each only once.

    Methods raise ConfigError or CalibrationError if the settings for a Velodyne's packets cannot be used.
    """

    def __init__(
        self,
        recording: Recording,
        velodyne: VelodyneConfig | None = None,
        *,
        limits: LimitsConfig = DEFAULT_LIMITS,
    ) -> None:
        self._recording = recording
        self._limits = limits
        self._velodyne = VelodyneDecoders(velodyne or VelodyneConfig())
        self._found: dict[tuple[str, str], Any | MessageError] = {}
        self._sizes: dict[tuple[str, str], tuple[int, int] | None] = {}

    def decoded(self, topic: str, msgtypes: Collection[str]) -> Any:
        """The first message of `topic` with one of `msgtypes`, decoded, without its points, pixels or packets.

        Raises:
            MessageError: none of the first messages can be decoded; quotes the first error.
        """
        key = (topic, min(msgtypes))
        if key not in self._found:
            self._found[key] = self._read(topic, msgtypes)
        if isinstance(found := self._found[key], MessageError):
            raise found
        return found

    def missing(self, topic: str, msgtypes: Collection[str]) -> bool:
        """Whether none of the topic's first messages can be decoded."""
        try:
            self.decoded(topic, msgtypes)
        except MessageError:
            return True
        return False

    def frame(self, topic: str, msgtypes: Collection[str]) -> str:
        """Frame that the topic's messages name; empty if they name none or cannot be decoded."""
        if self.missing(topic, msgtypes):
            return ""
        message = self.decoded(topic, msgtypes)
        return clean_frame(getattr(message, "header", message).frame_id)

    def image_size(self, topic: str, msgtypes: Collection[str]) -> tuple[int, int] | None:
        """(width, height) in pixels of the topic's first image; None if unknown."""
        if self.missing(topic, msgtypes):
            return None
        message = self.decoded(topic, msgtypes)
        if message.__msgtype__ in VIDEO:
            key = (topic, min(msgtypes))
            if key not in self._sizes:
                self._sizes[key] = first_image_size(self._recording.messages([topic]), limits=self._limits)
            return self._sizes[key]
        if hasattr(message, "width"):
            return int(message.width), int(message.height)
        return self._sizes[topic, min(msgtypes)]

    def _read(self, topic: str, msgtypes: Collection[str]) -> Any:
        """The message, or the MessageError to raise."""
        fault: MessageError | None = None
        tried = 0
        for message in self._recording.messages([topic]):
            if message.channel.msgtype not in msgtypes:
                continue
            tried += 1
            try:
                if message.channel.msgtype == SCAN:  # the model may be unknown
                    self._velodyne[topic](message)
                if message.channel.msgtype in VIDEO:
                    read_packet(message)
                return self._without_content(deserialize(message, limits=self._limits), (topic, min(msgtypes)))
            except MessageError as err:
                fault = fault or err
            if tried == TRIES:
                break
        return MessageError(f"{topic}: none of its first {tried} messages can be decoded: {fault or 'it has none'}")

    def _without_content(self, message: Any, key: tuple[str, str]) -> Any:
        """The message without its largest field: a rig may have hundreds of topics with large messages."""
        if message.__msgtype__ == COMPRESSED_IMAGE:
            self._sizes[key] = image_size(message.data.tobytes())
        if hasattr(message, "data"):
            object.__setattr__(message, "data", ())
        return message
