"""The echoes of a beam: reflected light by range, and what the receiver detects in it.

Light is a share: a white wall, hit by the whole beam at a right angle, returns 1 at any range. The receiver gets
share / r^2, and detects an echo of share s up to r = max_range * sqrt(s).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidcam.bags.simulator.world.mesh import Material
from lidcam.bags.simulator.world.scene import STATIC, Hits
from lidcam.bags.simulator.world.textures import surface_reflectivity
from lidcam.pipeline.core.arrays import F64, I64, Table

NO_ECHO = 0.0  # range without an echo

# The Oren-Nayar model of rough surfaces (Generalization of Lambert's reflectance model, 1994) for light reflected back
# to its source, with facets tilted by 0.5 rad: asphalt stays visible at grazing angles, as in reality.
_ROUGHNESS2 = 0.5**2
_STRAIGHT = 1 - 0.5 * _ROUGHNESS2 / (_ROUGHNESS2 + 0.33)
_GRAZING = 0.45 * _ROUGHNESS2 / (_ROUGHNESS2 + 0.09)


class Optics:
    """Optical properties of the surfaces of a scene."""

    def __init__(self, palette: Sequence[Material]) -> None:
        self._palette = tuple(palette)
        self._mirror = np.array([material.mirror for material in palette], np.float64)
        self.transmission = np.array([*(material.transmission for material in palette), 0.0])  # the last of a miss
        self.max_reflectivity = max((material.reflectivity for material in palette), default=0.0)

    def share(self, hits: Hits, cos_incidence: F64) -> F64:
        """(N,) share of a beam that each surface reflects straight back; 0 for a miss."""
        share = np.zeros(len(hits))
        rows = np.flatnonzero(hits.material >= 0)
        hits = hits.select(rows)
        reflectivity = surface_reflectivity(self._palette, hits.material, hits.local, hits.normal)
        share[rows] = returned_share(reflectivity, self._mirror.take(hits.material), cos_incidence.take(rows))
        return share


def returned_share(reflectivity: npt.NDArray[np.floating], mirror: F64, cos_incidence: F64) -> F64:
    """(N,) share of a beam that surfaces reflect straight back; reflectivity and mirror (N,) are those of `Material`.

    A rough surface reflects less at grazing angles. A specular one is smooth and loses the mirrored part (Schlick,
    1994), so it vanishes at grazing angles. A retroreflector does not depend on the angle.
    """
    cos = np.clip(cos_incidence, 0.0, 1.0)
    falloff = (_STRAIGHT * cos + _GRAZING * (1 - cos * cos)) / _STRAIGHT
    shiny = np.flatnonzero(mirror > 0)
    falloff[shiny] = cos[shiny] * (1 - (1 - cos[shiny]) ** 5)
    falloff[reflectivity > 1] = 1.0
    return np.asarray(reflectivity * falloff, np.float64)


def intensity(share: F64) -> F64:
    """Reflectivity on Velodyne's scale: 0 to 100 from black to white, 101 to 255 for retroreflectors (its manuals)."""
    with np.errstate(divide="ignore"):
        return np.rint(np.where(share <= 1, 100 * share, 255 - 154 / np.maximum(share, 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """The strongest and the last echo of N beams."""

    range_m: F64  # (N, 2) metres of the strongest and the last echo, without noise; `NO_ECHO` for none
    share: F64  # (N, 2) share of the beam's light
    mover: I64  # (N, 2) row of the mover it comes from


@dataclass(frozen=True, slots=True, eq=False)
class Reflected(Table):
    """Light reflected by K surfaces."""

    beam: I64  # (K,) number of the beam
    range_m: F64  # (K,) metres; infinite for a miss
    share: F64  # (K,) share of the beam's light
    mover: I64  # (K,) row of the mover it comes from


def distinct_echoes(
    light: Reflected, count: int, *, reach_m: float, nearest_m: float, apart_m: float, second_strongest: bool
) -> Echoes:
    """The echoes of the beams 0 to `count` - 1, from their light in any order.

    Surfaces less than `apart_m` apart give one echo at the light-weighted mean of their ranges, which makes the mixed
    points between two things. The longest range is `reach_m` for a share of 1. With `second_strongest` the strongest
    echo is replaced by the second strongest where it is also the last, as a Velodyne in dual mode does.
    """
    echoes = Echoes(np.full((count, 2), NO_ECHO), np.zeros((count, 2)), np.full((count, 2), STATIC, np.int64))
    found = _echoes_in_order(light.select(light.range_m >= nearest_m), apart_m)
    found = found.select(found.share * reach_m**2 >= found.range_m**2)
    if not len(found.beam):
        return echoes
    by_power = np.lexsort((found.share / found.range_m**2, found.beam))
    last = np.flatnonzero(np.append(found.beam[1:] != found.beam[:-1], True))
    strongest = by_power[last]
    if second_strongest:
        several = np.diff(last, prepend=-1) > 1
        strongest = np.where(several & (strongest == last), by_power[last - 1], strongest)
    for column, rows in enumerate((strongest, last)):
        beam = found.beam[rows]
        echoes.range_m[beam, column] = found.range_m[rows]
        echoes.share[beam, column] = found.share[rows]
        echoes.mover[beam, column] = found.mover[rows]
    return echoes


def _echoes_in_order(light: Reflected, apart_m: float) -> Reflected:
    """Light by beam and range, with nearby surfaces merged; the mover is that of the brightest one."""
    light = light.select(np.isfinite(light.range_m) & (light.share > 0))
    light = light.select(np.lexsort((light.range_m, light.beam)))
    if not len(light.beam):
        return light
    begins = np.append(True, (np.diff(light.beam) > 0) | (np.diff(light.range_m) > apart_m))
    first = np.flatnonzero(begins)
    share = np.add.reduceat(light.share, first)
    range_m = np.add.reduceat(light.share * light.range_m, first) / share
    echo = np.cumsum(begins) - 1
    brightest = np.flatnonzero(light.share == np.maximum.reduceat(light.share, first)[echo])
    _, chosen = np.unique(echo[brightest], return_index=True)
    return Reflected(light.beam[first], range_m, share, light.mover[brightest[chosen]])
