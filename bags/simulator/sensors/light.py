"""Daylight on surfaces, in linear light: sun, sky with clouds, haze, and specular reflection.

One unit is roughly the light of a white horizontal surface in full daylight, by way of `Light.exposure`. Matt surfaces
follow Lambert's law; specular ones (glass, paint) reflect the sky, by Schlick's approximation of Fresnel's law (Schlick
1994), and show a glint of the sun.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from lidcam.bags.simulator.scenario.scenario import SunScenario
from lidcam.bags.simulator.world.mesh import Material
from lidcam.bags.simulator.world.scene import dotted
from lidcam.bags.simulator.world.textures import SIZE, noise
from lidcam.pipeline.core.arrays import F32, F64, I64

SUN_RGB = np.array([1.15, 1.08, 0.95], np.float32)  # irradiance facing the sun
SKY_IRRADIANCE_RGB = np.array([0.30, 0.36, 0.46], np.float32)  # irradiance facing up
BOUNCE_RGB = np.array([0.17, 0.16, 0.14], np.float32)  # irradiance facing down, from the ground
HORIZON_RGB = np.array([0.78, 0.85, 0.92], np.float32)
ZENITH_RGB = np.array([0.17, 0.36, 0.74], np.float32)
GROUND_RGB = np.array([0.30, 0.29, 0.26], np.float32)  # below the horizon where nothing is hit
CLOUD_RGB = np.array([0.98, 0.98, 0.98], np.float32)
HAZE_M = 1100.0  # distance over which contrast drops to 37 %
GLINT_SQUARINGS, GLINT = 7, 8.0  # the sun's glint falls off with the 2^7-th power of a cosine
WHITE = 1.08  # exposed light of a matt white (0.9) horizontal surface in the sun, before the tone curve


@dataclass(frozen=True, slots=True, eq=False)
class Shading:
    """Light from N surface points to the camera."""

    rest: F32  # (N, 3) light that does not depend on the sun: skylight, ground light, reflected sky, haze
    sun: F32  # (N, 3) sunlight, to be added outside of shadows


class Light:
    """The light of a scenario on the materials of a scene."""

    def __init__(self, sun: SunScenario, palette: Sequence[Material]) -> None:
        azimuth, elevation = np.deg2rad(sun.azimuth_deg), np.deg2rad(sun.elevation_deg)
        self.towards: F64 = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        self.shadows = sun.shadows
        self._towards = self.towards.astype(np.float32)
        self._mirror = np.array([material.mirror for material in palette], np.float32)
        on_ground = SUN_RGB * max(self._towards[2], 0.15) + SKY_IRRADIANCE_RGB
        self.exposure = float(WHITE / (0.9 * on_ground.mean()))

    def sky(self, directions: F32, *, clouds: bool = True) -> F32:
        """Radiance (N, 3) of the sky, or of the ground below the horizon, in directions (N, 3)."""
        up = directions[:, 2]
        share = np.sqrt(np.clip(up, 0.0, 1.0))
        near_sun = np.clip(dotted(directions, self._towards), 0.0, 1.0)
        glow = _squared(near_sun, 3) * np.float32(0.22) + (near_sun > 0.99995) * np.float32(8)
        below = 1 - np.exp(np.minimum(up, 0.0) * np.float32(9))
        light = HORIZON_RGB + share[:, None] * (ZENITH_RGB - HORIZON_RGB)
        if clouds:
            light += self._cloud_cover(directions)[:, None] * (CLOUD_RGB - light)
        light += glow[:, None] * (SUN_RGB * np.float32(0.8))
        light += below[:, None] * (GROUND_RGB - light)
        return np.asarray(light, np.float32)

    def surface(self, albedo: F32, material: I64, normal: F32, directions: F32, distance: F32) -> Shading:
        """Light from surface points (N): linear albedo (N, 3), directions from the camera, normals towards it."""
        up = 0.5 + 0.5 * normal[:, 2]
        facing_sun = np.maximum(dotted(normal, self._towards), 0.0)
        rest = albedo * (BOUNCE_RGB + up[:, None] * (SKY_IRRADIANCE_RGB - BOUNCE_RGB))
        sun = np.asarray(albedo * (facing_sun[:, None] * SUN_RGB), np.float32)
        mirrors = np.flatnonzero(self._mirror.take(material) > 0)
        if len(mirrors):
            self._add_mirrored(rest, sun, mirrors, material, normal, directions)
        if len(distance) and distance.max() > 0.01 * HAZE_M:
            clear = self.clearness(distance)[:, None]
            rest += (1 - clear) * (HORIZON_RGB * np.float32(0.85) - rest)
            sun *= clear
        return Shading(rest, sun)

    def clearness(self, distance: F32) -> F32:
        """Share (N,) of a surface's light that passes the haze; 0 for infinite distance."""
        return np.asarray(np.exp(distance * np.float32(-1 / HAZE_M)), np.float32)

    def _add_mirrored(self, rest: F32, sun: F32, rows: I64, material: I64, normal: F32, directions: F32) -> None:
        """Add the reflected sky and the sun's glint to some of the points, in place."""
        normal, directions = normal.take(rows, 0), directions.take(rows, 0)
        against = np.clip(-dotted(normal, directions), 0.0, 1.0)
        base = self._mirror.take(material.take(rows))
        fresnel = base + (1 - base) * _squared(1 - against, 2) * (1 - against)
        mirrored = directions + (2 * against)[:, None] * normal
        glint = _squared(np.clip(dotted(mirrored, self._towards), 0.0, 1.0), GLINT_SQUARINGS)
        glint *= np.float32(GLINT) * (dotted(normal, self._towards) > 0)
        matt_rest, matt_sun, share = rest.take(rows, 0), sun.take(rows, 0), fresnel[:, None]
        rest[rows] = matt_rest + share * (self.sky(mirrored, clouds=False) - matt_rest)
        sun[rows] = matt_sun + share * (glint[:, None] * SUN_RGB - matt_sun)

    def _cloud_cover(self, directions: F32) -> F32:
        """Cloud cover (N,) of the sky, 0 to 1."""
        height = np.maximum(directions[:, 2], 0.02) + np.float32(0.12)
        u, v = directions[:, 0] / height * 90 + 11, directions[:, 1] / height * 90 + 37
        rows = -(-len(u) // 1024)  # OpenCV limits images to 32767 pixels a side
        grid = np.zeros((2, rows * 1024), np.float32)
        grid[0, : len(u)], grid[1, : len(u)] = u % SIZE, v % SIZE
        if not rows:
            return np.empty(0, np.float32)
        x, y = grid.reshape(2, rows, 1024)
        cover = cv2.remap(_cloud_map(), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).reshape(-1)[: len(u)]
        return np.asarray(cover * np.clip(directions[:, 2] * 6, 0.0, 1.0), np.float32)


def _squared(values: F32, times: int) -> F32:
    for _ in range(times):
        values = values * values
    return values


@cache
def _cloud_map() -> F32:
    """Cloud cover (0 to 1) of a tileable square of sky, from noise with a natural spectrum."""
    share = np.clip((noise(7, lambda frequency: (frequency + 0.006) ** -1.8) - 0.35) / 1.4, 0.0, 1.0)
    return np.asarray(0.9 * share * share * (3 - 2 * share), np.float32)
