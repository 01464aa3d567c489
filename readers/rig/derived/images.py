"""Images that nodes made of a camera's: one that something was drawn on keeps the pattern of the camera's."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.registry import types_of
from lidcam.readers.recording import Recording
from lidcam.readers.rig.derived.contents import Contents, Pair
from lidcam.readers.rig.first_messages import FirstMessages

IMAGE = types_of("image")

PATTERN_PX = 320, 240
"""Size at which the patterns of images are compared."""

MIN_PATTERN, MIN_COPY = 0.8, 0.98
"""Smallest correlations of an image's pattern with that of the same image, something drawn on it, and of its copy."""


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
        if pair.is_stamped and has_info(pair.sensor) and not has_info(pair.topic) and frame == other != "":
            return True
        made, image = contents.at(pair.topic, pair.log_ns), contents.at(pair.sensor, pair.sensor_log_ns)
        least = MIN_COPY if has_info(pair.topic) else MIN_PATTERN  # pairs of stereo cameras share a frame
        return float((made * image).sum()) >= least

    return contents.sources(sorted(ordered, key=rawness), is_made_of)


def _pattern(rgb: Any) -> F64:
    """(240, 320) what an image shows apart from its brightness, of unit length; zero where it shows nothing."""
    import cv2

    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(gray, PATTERN_PX, interpolation=cv2.INTER_AREA).astype(np.float64)
    pattern = small - cv2.blur(small, (15, 15))
    return np.asarray(pattern / max(float(np.linalg.norm(pattern)), 1e-9), np.float64)
