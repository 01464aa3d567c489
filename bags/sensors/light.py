"""Daylight on surfaces, in linear light: a sun, a sky with a few clouds, haze, and simple mirrors.

One unit of light is what a white horizontal surface sends back in full daylight, roughly; `Light.exposure` makes it so.
A matt surface follows Lambert; what mirrors (glass, paint) shows the sky in the mirror direction, by Schlick's
approximation of Fresnel's law (Schlick 1994), and a glint of the sun.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bags.scenario import SunScenario
from bags.world.mesh import Material

__all__ = ["Light", "Shading"]

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

SUN_RGB = np.array([1.15, 1.08, 0.95], np.float32)  # irradiance of a surface that faces the sun
SKY_IRRADIANCE_RGB = np.array([0.30, 0.36, 0.46], np.float32)  # of a surface that faces up
BOUNCE_RGB = np.array([0.17, 0.16, 0.14], np.float32)  # of one that faces down: light from the ground
HORIZON_RGB = np.array([0.78, 0.85, 0.92], np.float32)
ZENITH_RGB = np.array([0.17, 0.36, 0.74], np.float32)
GROUND_RGB = np.array([0.30, 0.29, 0.26], np.float32)  # where nothing is, below the horizon
CLOUD_RGB = np.array([0.98, 0.98, 0.98], np.float32)
HAZE_M = 1100.0
"""Over this way all but 37 % of the contrast is lost."""
GLINT_SQUARINGS, GLINT = 7, 8.0
"""The sun's glint falls off as the 2^7-th power of a cosine."""
WHITE = 1.08
"""Light that a matt white (0.9) horizontal surface in the sun exposes a pixel with, before the tone curve."""
CLOUD_CELLS = 512


@dataclass(frozen=True, slots=True, eq=False)
class Shading:
    """Light from N surface points to the camera.

    Attributes:
        rest: (N, 3) float32, whatever the sun does: sky light, light from the ground, mirrored sky, haze.
        sun: (N, 3) float32, to be added where nothing stands before the sun.
    """

    rest: F32
    sun: F32


class Light:
    """The light of one scenario and the materials that it falls on."""

    def __init__(self, sun: SunScenario, palette: Sequence[Material]) -> None:
        azimuth, elevation = np.deg2rad(sun.azimuth_deg), np.deg2rad(sun.elevation_deg)
        self.towards: F64 = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        self.shadows = sun.shadows
        self._towards = self.towards.astype(np.float32)
        self._mirror = np.array([material.mirror for material in palette], np.float32)
        self._clouds = _cloud_map()
        on_ground = SUN_RGB * max(self._towards[2], 0.15) + SKY_IRRADIANCE_RGB
        self.exposure = float(WHITE / (0.9 * on_ground.mean()))

    def sky(self, directions: F32, *, clouds: bool = True) -> F32:
        """Radiance (N, 3) of the sky, and of the ground at the horizon, in directions (N, 3)."""
        up = directions[:, 2]
        share = np.sqrt(np.clip(up, 0.0, 1.0))[:, None]
        rgb = HORIZON_RGB + share * (ZENITH_RGB - HORIZON_RGB)
        if clouds:
            cover = self._cloud_cover(directions)[:, None]
            rgb += cover * (CLOUD_RGB - rgb)
        near_sun = np.clip(directions @ self._towards, 0.0, 1.0)
        glow = _squared(near_sun, 3) * np.float32(0.22) + (near_sun > 0.99995) * np.float32(8)
        rgb += glow[:, None] * (SUN_RGB * np.float32(0.8))
        below = 1 - np.exp(np.minimum(up, 0.0) * np.float32(9))[:, None]
        rgb += below * (GROUND_RGB - rgb)
        return np.asarray(rgb, np.float32)

    def surface(self, albedo: F32, material: I64, normal: F32, directions: F32, distance: F32) -> Shading:
        """Light from surface points.

        Args:
            albedo: (N, 3) linear.
            material: (N,) rows of the palette.
            normal: (N, 3) unit vectors towards the camera's side.
            directions: (N, 3) unit vectors from the camera.
            distance: (N,) metres from the camera.
        """
        up = (0.5 + 0.5 * normal[:, 2])[:, None]
        facing_sun = np.maximum(normal @ self._towards, 0.0)[:, None]
        rest = albedo * (BOUNCE_RGB + up * (SKY_IRRADIANCE_RGB - BOUNCE_RGB))
        sun = albedo * (facing_sun * SUN_RGB)
        mirrors = np.flatnonzero(self._mirror[material] > 0)
        if len(mirrors):
            self._add_mirrored(
                rest, sun, mirrors, material.take(mirrors), normal.take(mirrors, 0), directions.take(mirrors, 0)
            )
        if len(distance) and distance.max() > 0.01 * HAZE_M:
            clear = self.clearness(distance)[:, None]
            rest += (1 - clear) * (HORIZON_RGB * np.float32(0.85) - rest)
            sun *= clear
        return Shading(rest, sun)

    def clearness(self, distance: F32) -> F32:
        """Share (N,) of a surface's own light that haze lets through; 0 for infinite distance."""
        return np.asarray(np.exp(distance * np.float32(-1 / HAZE_M)), np.float32)

    def _add_mirrored(self, rest: F32, sun: F32, rows: I64, material: I64, normal: F32, directions: F32) -> None:
        """Put the mirrored sky and the sun's glint on some of the points, in place."""
        against = np.clip(-np.einsum("ij,ij->i", normal, directions), 0.0, 1.0)
        base = self._mirror[material]
        fresnel = (base + (1 - base) * _squared(1 - against, 2) * (1 - against))[:, None]
        mirrored = directions + 2 * against[:, None] * normal
        glint = _squared(np.clip(mirrored @ self._towards, 0.0, 1.0), GLINT_SQUARINGS) * (normal @ self._towards > 0)
        matt_rest, matt_sun = rest.take(rows, 0), sun.take(rows, 0)
        rest[rows] = matt_rest + fresnel * (self.sky(mirrored, clouds=False) - matt_rest)
        sun[rows] = matt_sun + fresnel * ((np.float32(GLINT) * glint)[:, None] * SUN_RGB - matt_sun)

    def _cloud_cover(self, directions: F32) -> F32:
        """Share (N,) of the sky that is cloud."""
        height = np.maximum(directions[:, 2], 0.02) + np.float32(0.12)
        u, v = directions[:, 0] / height * 90 + 11, directions[:, 1] / height * 90 + 37
        rows = -(-len(u) // 1024)  # OpenCV's pictures are less than 32768 pixels long
        grid = np.zeros((2, rows * 1024), np.float32)
        grid[0, : len(u)], grid[1, : len(u)] = u % CLOUD_CELLS, v % CLOUD_CELLS
        if not rows:
            return np.empty(0, np.float32)
        x, y = grid.reshape(2, rows, 1024)
        cover = cv2.remap(self._clouds, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).reshape(-1)[: len(u)]
        return np.asarray(cover * np.clip(directions[:, 2] * 6, 0.0, 1.0), np.float32)


def _squared(values: F32, times: int) -> F32:
    """Values squared again and again."""
    for _ in range(times):
        values = values * values
    return values


def _cloud_map() -> F32:
    """Cover, 0 to 1, of a square of sky that can be laid side by side: noise whose octaves fall off as in nature."""
    random = np.random.Generator(np.random.PCG64(7))
    spectrum = np.fft.rfft2(random.standard_normal((CLOUD_CELLS, CLOUD_CELLS)))
    frequency = np.hypot(np.fft.fftfreq(CLOUD_CELLS)[:, None], np.fft.rfftfreq(CLOUD_CELLS))
    frequency[0, 0] = np.inf
    noise = np.fft.irfft2(spectrum / (frequency + 0.006) ** 1.8, (CLOUD_CELLS, CLOUD_CELLS))
    noise /= noise.std()
    share = np.clip((noise - 0.35) / 1.4, 0.0, 1.0)
    return np.asarray(0.9 * share * share * (3 - 2 * share), np.float32)
