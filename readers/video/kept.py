"""Packets of a video that wait for the frame whose image is decoded from them, for viewers that decode video."""

from collections import deque
from typing import NamedTuple

from lidcam.pipeline.core.messages import RawMessage, VideoPart
from lidcam.readers.video.packets import VideoPacket, begins_video

MAX_KEPT_BYTES = 64 << 20
"""Bytes of packets of one video that wait for a frame; beyond these, packets are kept from the next key frame on."""


class _Kept(NamedTuple):
    image: tuple[object, ...]  # Of which image the packet is
    codec: str
    data: bytes
    begins: bool  # Whether a viewer can begin with it


class KeptPackets:
    """The decoded packets of one video since the last one that went with a frame."""

    def __init__(self) -> None:
        self._waiting: deque[_Kept] = deque()
        self._bytes = 0
        self._goes_on, self._is_in_order = False, True

    def add(self, packet: VideoPacket, message: RawMessage) -> None:
        """Keep a packet whose image is decoded, unless one before it is missing."""
        begins = begins_video(packet)
        self._goes_on |= begins and self._is_in_order
        if self._goes_on:
            self._waiting.append(_Kept(_image_of(message), packet.codec, packet.data.tobytes(), begins))
            self._bytes += len(packet.data)
        if self._bytes > MAX_KEPT_BYTES:
            self._waiting.clear()
            self._bytes, self._goes_on = 0, False

    def interrupt(self) -> None:
        """Take note that a packet is missing: none is kept before the next with which a viewer can begin."""
        self._goes_on = False

    def give_up(self) -> None:
        """Take note that images are not in the order of their packets, which no viewer is told of: none is kept."""
        self._goes_on = self._is_in_order = False
        self._waiting.clear()

    def take(self, message: RawMessage) -> VideoPart | None:
        """The packets up to that of an image, from the last that a viewer can begin with; None if that is missing."""
        image = _image_of(message)
        if all(kept.image != image for kept in self._waiting):
            return None
        taken: list[_Kept] = []
        while not taken or taken[-1].image != image:
            kept = self._waiting.popleft()
            self._bytes -= len(kept.data)
            taken = [kept] if kept.begins else [*taken, kept]
        return VideoPart(taken[-1].codec, tuple(kept.data for kept in taken))


def _image_of(message: RawMessage) -> tuple[object, ...]:
    return message.log_time_ns, message.order  # stamps are corrected where a clock is off
