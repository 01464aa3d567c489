"""From light to pixels: exposure, vignette, tone, sRGB, noise."""

from functools import cache, cached_property

import numpy as np

from lidcam.bags.simulator.sensors.timing import random_numbers
from lidcam.pipeline.core.arrays import F32, F64, I16, I64, U8

FRACTION = 64
"""Images are kept in this fraction of a pixel value until noise is added."""
BRIGHTEST = 4.0
"""Light beyond this is clipped."""
SHOULDER = 0.55
"""Above this the tone curve compresses highlights instead of clipping them."""
VIGNETTE = 0.10
"""Share of the light that the corners lose."""
NOISE_ROOM_PX = 96
"""The noise field is larger than the image by this; each image uses a random crop."""
ROWS_AT_ONCE = 64
"""Rows read out together: they fit into the processor's caches."""
SHARED_NOISE = 0.8  # red, green and blue noise are correlated, as after demosaicing; 0.8^2 + 0.6^2 = 1


class Film:
    """The image sensor of a camera.

    Args:
        exposure: Factor on all light.
        noise: Standard deviation of pixel values (0 to 255).
    """

    def __init__(self, name: str, width: int, height: int, *, exposure: float, noise: float, seed: int) -> None:
        self._name, self._seed, self._noise = name, seed, noise
        self._height, self._width = height, width
        x = (np.arange(width) - (width - 1) / 2) / max(np.hypot(width, height) / 2, 1)
        y = (np.arange(height) - (height - 1) / 2) / max(np.hypot(width, height) / 2, 1)
        loss = 1 - VIGNETTE * (x**2 + y[:, None] ** 2)
        self._scale = np.asarray(exposure * loss * (65535 / BRIGHTEST), np.float32)[..., None]

    @cached_property
    def _field(self) -> I16:
        """The noise field."""
        shape = (self._height + NOISE_ROOM_PX, self._width + NOISE_ROOM_PX, 3)
        random = random_numbers(self._seed, self._name, "noise field", 0)
        field = 0.6 * random.standard_normal(shape, np.float32)
        shared = SHARED_NOISE * random.standard_normal(shape[:2], np.float32)
        for color in range(3):
            field[..., color] += shared
        field *= np.float32(self._noise * FRACTION)
        return np.clip(np.round(field, out=field), -32767, 32767, out=field).astype(np.int16)

    def developed(self, linear: F32) -> I16:
        """Pixel values times `FRACTION` of an image (H, W, 3) of linear light."""
        return _encoded(linear * self._scale)

    def developed_pixels(self, linear: F32, pixels: I64) -> I16:
        """`developed` for some pixels (K, 3), numbered row by row."""
        scale = self._scale.reshape(-1).take(pixels)
        scaled = np.empty_like(linear)
        for color in range(3):
            np.multiply(linear[:, color], scale, out=scaled[:, color])
        return _encoded(scaled)

    def read_out(self, developed: I16, number: int) -> U8:
        """The final pixels (H, W, 3) of image `number`, with noise."""
        height, width, _ = developed.shape
        field: I16 | None = None
        added = True
        if self._noise:
            random = random_numbers(self._seed, self._name, "noise", number)
            top, left = random.integers(0, NOISE_ROOM_PX, 2)
            field = self._field[top : top + height, left : left + width]
            added = random.random() < 0.5
        image = np.empty(developed.shape, np.uint8)
        for first in range(0, height, ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            values = developed[rows] + np.int16(FRACTION // 2)
            if field is not None and added:
                values += field[rows]
            elif field is not None:
                values -= field[rows]
            values >>= 6  # FRACTION
            image[rows] = np.clip(values, 0, 255, out=values)
        return image


def _encoded(scaled: F32) -> I16:
    return np.take(_values(), np.clip(scaled, 0, 65535, out=scaled).astype(np.uint16))


@cache
def _values() -> I16:
    """Lookup table: pixel values times `FRACTION` of light from 0 to `BRIGHTEST`, in 65536 steps."""
    linear: F64 = np.linspace(0.0, BRIGHTEST, 65536)
    return np.round(255 * FRACTION * srgb_from_linear(_toned(linear))).astype(np.int16)


def srgb_from_linear(linear: F64) -> F64:
    """SRGB values (0 to 1) of linear light (IEC 61966-2-1)."""
    light = np.clip(linear, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def _toned(linear: F64) -> F64:
    """The tone curve: linear up to `SHOULDER`, then smoothly towards 1."""
    room = 1 - SHOULDER
    over = np.maximum(linear - SHOULDER, 0.0)
    return np.where(linear <= SHOULDER, linear, SHOULDER + room * (1 - np.exp(-over / room)))
