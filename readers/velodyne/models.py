"""Velodyne's spinning lidars: where each laser points, when it fires, and how packets encode its ranges.

A data packet has 12 blocks of 32 ranges under one azimuth each (Velodyne's VLP-16 User Manual 63-9243 Rev. E, section
9, and its siblings). A column is one cycle of the firing order: one block, or one per bank of 32 lasers. Angles follow
the manuals: azimuth clockwise from the front as seen from above, elevation up.

The elevations and azimuth offsets are those of velodyne_decoder's tables (BSD-3-Clause: velodyne_models.LICENSE.txt).
An HDL-64E has a table of its own per unit, so none is built in.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, U16, CheckedTable

BLOCK_FLAGS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
"""First two bytes (little endian) of a block, by bank of lasers."""


class RangeCorrections(NamedTuple):
    """Corrections to an HDL-64E's ranges and reflectivities, by laser id (manual 63-HDL64ES3, appendix E)."""

    far_m: F64  # (L,) added to ranges, measured at 25.04 m (`dist_correction`)
    near_x_m: F64  # (L,) the same at 2.40 m to the side; zero if not measured
    near_y_m: F64  # (L,) the same at 1.93 m ahead; zero if not measured
    horizontal_offset_m: F64  # (L,) of the beam from the axis
    focal_distance: F64  # (L,) in units of the reflectivity formula
    focal_slope: F64  # (L,) in units of the reflectivity formula
    min_intensity: F64  # (L,) lowest reflectivity reported
    max_intensity: F64  # (L,) highest reflectivity reported

    @property
    def any_set(self) -> bool:
        """Whether any value corrects anything."""
        return any(values.any() for values in self[:-1]) or bool((self.max_intensity != 255).any())


@dataclass(frozen=True, slots=True, eq=False)
class LaserTable(CheckedTable):
    """Directions of the lasers of one unit, by laser id."""

    elevation_rad: F64  # (L,) above the horizon
    azimuth_offset_rad: F64  # (L,) subtracted from the azimuth of the firing
    vertical_offset_m: F64  # (L,) added to z: the beams cross in front of the axis, not on it
    corrections: RangeCorrections | None = None  # Corrections of ranges; None for all but the HDL-64E

    @property
    def rings(self) -> U16:
        """(L,) rank of each laser by elevation from the lowest up, as in ROS's driver."""
        ranks = np.empty(len(self), np.uint16)
        ranks[np.argsort(self.elevation_rad, kind="stable")] = np.arange(len(self), dtype=np.uint16)
        return ranks


class VelodyneModel(NamedTuple):
    """Constants of one model."""

    name: str  # Name in the settings
    product: int | None  # Factory byte 1205 of its packets; None if that byte is something else
    banks: int  # Blocks of one column: one per 32 lasers
    range_step_m: float  # One unit of range, by the packet format
    column_us: float  # Time from one column to the next
    slot_us: tuple[tuple[float, ...], ...]  # Time of each of the 32 ranges of a block since its column began, by bank
    first_us: float = 0.0  # Time of the first firing since the packet's own time
    lasers: int = 32  # Number of lasers; with 16, a block holds two firings of all

    @property
    def columns(self) -> int:
        """Columns of a packet with one return per firing."""
        return 12 // self.banks

    @property
    def columns_dual(self) -> int:
        """Columns of a packet with two returns per firing; the VLS-128 leaves four blocks empty then."""
        return self.columns // 2


def _vls128(channel_us: float) -> VelodyneModel:
    # Eight lasers fire at once, 16 groups and 4 pauses to a column. The packet's time is that of the fourth group: by
    # the manual 8.7 us after the first; LidarView and velodyne_decoder take 7 us.
    slot_us = tuple(
        tuple((g + g // 8 * 2) * channel_us for g in range(4 * b, 4 * b + 4) for _ in range(8)) for b in range(4)
    )
    return VelodyneModel("VLS-128", 0xA1, 4, 0.004, 20 * channel_us, slot_us, -7.0, 128)


def _hdl64(name: str, column_us: float, group_us: float, pattern_us: tuple[float, ...]) -> VelodyneModel:
    slot_us = tuple(group_us * (slot // 4) + pattern_us[slot % 4] for slot in range(32))
    return VelodyneModel(name, None, 2, 0.002, column_us, (slot_us, slot_us), 0.0, 64)


_VLP16_SLOTS = tuple(55.296 * (slot // 16) + 2.304 * (slot % 16) for slot in range(32))
_VLP32_SLOTS = tuple(2.304 * (slot // 2) for slot in range(32))

VLS128_FIRST_FIRMWARE = _vls128(8 / 3)
"""A VLS-128 with firmware before 5.2.3.0: a packet takes 160 us, later 173.3 us."""

MODELS = {
    model.name: model
    for model in (
        VelodyneModel("VLP-16", 0x22, 1, 0.002, 110.592, (_VLP16_SLOTS,), lasers=16),
        VelodyneModel("Puck Hi-Res", 0x24, 1, 0.002, 110.592, (_VLP16_SLOTS,), lasers=16),
        VelodyneModel("HDL-32E", 0x21, 1, 0.002, 46.08, (tuple(1.152 * slot for slot in range(32)),)),
        _hdl64("HDL-64E S2", 48.0, 6.0, (0.0, 1.26, 2.46, 3.66)),
        _hdl64("HDL-64E S3", 57.6, 7.2, (0.0, 1.3, 2.5, 3.7)),
        VelodyneModel("VLP-32A", 0x23, 1, 0.004, 55.296, (_VLP32_SLOTS,)),
        VelodyneModel("VLP-32B", 0x23, 1, 0.004, 55.296, (_VLP32_SLOTS,)),
        VelodyneModel("VLP-32C", 0x28, 1, 0.004, 55.296, (_VLP32_SLOTS,)),
        _vls128(2.89),
    )
}
"""All models that can be read, by name."""


@lru_cache
def built_in_table(model: str) -> LaserTable:
    """The table from a model's manual; raises KeyError if the model is an HDL-64E or not one of `MODELS`."""
    elevation_deg, azimuth_offset_deg, focal_m = _TABLES[model]
    elevation_rad = np.deg2rad(np.array(elevation_deg, np.float64))
    azimuth_offset_rad = np.deg2rad(np.resize(np.array(azimuth_offset_deg, np.float64), len(elevation_rad)))
    # All beams cross in one point ahead of the axis (drawings 86-0101, 86-0106 and their siblings).
    return LaserTable(elevation_rad, azimuth_offset_rad, focal_m * np.tan(-elevation_rad))


# fmt: off
_VLP16_ELEVATION_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
_HI_RES_ELEVATION_DEG = (
    -10, 0.667, -8.667, 2, -7.333, 3.333, -6, 4.667, -4.667, 6, -3.333, 7.333, -2, 8.667, -0.667, 10,
)
_HDL32E_ELEVATION_DEG = (
    -30.67, -9.33, -29.33, -8, -28, -6.67, -26.67, -5.33, -25.33, -4, -24, -2.67, -22.67, -1.33, -21.33, 0, -20,
    1.33, -18.67, 2.67, -17.33, 4, -16, 5.33, -14.67, 6.67, -13.33, 8, -12, 9.33, -10.67, 10.67,
)
_VLP32A_ELEVATION_DEG = (
    -14.3, 0.8337, 12.5, -0.5, -10.7, 2.167, 8.9, -1.834, -7, 1.167, 6, -0.167, -4.9, 2.5, 3.8, -1.5, -2.167,
    10.7, 1.834, -8.9, -2.5, 4.9, 1.5, -3.8, -0.834, 14.3, 0.5, -12.5, -1.167, 7, 0.167, -6,
)
_VLP32A_AZIMUTH_DEG = (
    -1.2, 1.2, -1.2, 1.2, -1.2, 1.2, -1.2, 1.2, -1.2, 3.6, -1.2, 3.6, -1.2, 3.6, -1.2, 3.6, -1.2, 1.2, -1.2,
    1.2, -3.6, 1.2, -3.6, 1.2, -1.2, 1.2, -1.2, 1.2, -3.6, 1.2, -3.6, 1.2,
)
_VLP32C_ELEVATION_DEG = (
    -25, -1, -1.667, -15.639, -11.31, 0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667,
    -4, -4.667, 1.667, 1, -3.667, -3.333, 3.333, 2.333, -2.667, -3, 7, 4.667, -2.333, -2, 15, 10.333, -1.333,
)
_VLP32C_AZIMUTH_DEG = (
    -1.4, 4.2, -1.4, 1.4, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4,
    4.2, -4.2, 1.4, -1.4, 1.4, -1.4, 1.4, -1.4, 4.2, -4.2, 1.4, -1.4, 1.4,
)
_VLS128_ELEVATION_DEG = (
    -11.742, -1.99, 3.4, -5.29, -0.78, 4.61, -4.08, 1.31, -6.5, -1.11, 4.28, -4.41, 0.1, 6.48, -3.2, 2.19,
    -3.86, 1.53, -9.244, -1.77, 2.74, -5.95, -0.56, 4.83, -2.98, 2.41, -6.28, -0.89, 3.62, -5.07, 0.32, 7.58,
    -0.34, 5.18, -3.64, 1.75, -25, -2.43, 2.96, -5.73, 0.54, 9.7, -2.76, 2.63, -7.65, -1.55, 3.84, -4.85, 3.18,
    -5.51, -0.12, 5.73, -4.3, 1.09, -16.042, -2.21, 4.06, -4.63, 0.76, 15, -3.42, 1.97, -6.85, -1.33, -5.62,
    -0.23, 5.43, -3.53, 0.98, -19.582, -2.32, 3.07, -4.74, 0.65, 11.75, -2.65, 1.86, -7.15, -1.44, 3.95, -2.1,
    3.29, -5.4, -0.01, 4.5, -4.19, 1.2, -13.565, -1.22, 4.17, -4.52, 0.87, 6.08, -3.31, 2.08, -6.65, 1.42,
    -10.346, -1.88, 3.51, -6.06, -0.67, 4.72, -3.97, 2.3, -6.39, -1, 4.39, -5.18, 0.21, 6.98, -3.09, 4.98,
    -3.75, 1.64, -8.352, -2.54, 2.85, -5.84, -0.45, 8.43, -2.87, 2.52, -6.17, -1.66, 3.73, -4.96, 0.43,
)
_VLS128_AZIMUTH_DEG = (-6.354, -4.548, -2.732, -0.911, 0.911, 2.732, 4.548, 6.354)
# fmt: on

# Elevations, azimuth offsets (repeated as often as needed), distance from the axis to the point where the beams cross.
_TABLES: dict[str, tuple[tuple[float, ...], tuple[float, ...], float]] = {
    "VLP-16": (_VLP16_ELEVATION_DEG, (0.0,), 0.04191),
    "Puck Hi-Res": (_HI_RES_ELEVATION_DEG, (0.0,), 0.04191),
    "HDL-32E": (_HDL32E_ELEVATION_DEG, (0.0,), 0.02883),
    "VLP-32A": (_VLP32A_ELEVATION_DEG, _VLP32A_AZIMUTH_DEG, 0.0424),
    "VLP-32B": (_VLP32C_ELEVATION_DEG, _VLP32C_AZIMUTH_DEG, 0.0424),
    "VLP-32C": (_VLP32C_ELEVATION_DEG, _VLP32C_AZIMUTH_DEG, 0.0424),
    "VLS-128": (_VLS128_ELEVATION_DEG, _VLS128_AZIMUTH_DEG, 0.05863),
}
