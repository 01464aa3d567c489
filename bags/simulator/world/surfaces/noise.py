"""Seamless noise images, looked up by position instead of computed at every point."""

from functools import cache

import numpy as np

from lidcam.pipeline.core.arrays import F32

SIZE = 512  # a power of two: positions wrap by masking bits


def grain(u: F32, v: F32, cell_m: float) -> F32:
    """Noise (N,) of mean 0 and standard deviation 1, at all scales from one cell to 200 cells."""
    return _look_up(_cloudy(), u * np.float32(1 / cell_m), v * np.float32(1 / cell_m))


def cells(u: F32, v: F32) -> F32:
    """Independent values (N,) in [-1, 1), one per unit square."""
    return _look_up(_white(), u, v)


def _look_up(image: F32, u: F32, v: F32) -> F32:
    # Adding a whole number of periods makes the cast round down for negative positions, too.
    column = (u + np.float32(1 << 20)).astype(np.int32)
    row = (v + np.float32(1 << 20)).astype(np.int32)
    return np.asarray(image.take(((row & (SIZE - 1)) << 9) | (column & (SIZE - 1))))


@cache
def _white() -> F32:
    generator = np.random.Generator(np.random.PCG64(101))
    return generator.uniform(-1.0, 1.0, SIZE * SIZE).astype(np.float32)


@cache
def _cloudy() -> F32:
    """Noise with an amplitude that falls with frequency; it tiles, as its spectrum is discrete."""
    generator = np.random.Generator(np.random.PCG64(102))
    white = generator.standard_normal((SIZE, SIZE))
    frequency = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None])
    share = 1 / np.maximum(frequency, 1 / 200) ** 0.8
    share[0, 0] = 0.0
    rough = np.fft.irfft2(np.fft.rfft2(white) * share, (SIZE, SIZE))
    return np.asarray((rough / rough.std()).ravel(), np.float32)
