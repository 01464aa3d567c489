"""Elevations of the beams of lidars on the market, in degrees."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from lidcam.readers.velodyne.models import built_in_table


def _even(low: float, high: float, beams: int) -> tuple[float, ...]:
    return tuple(np.linspace(low, high, beams).round(3).tolist())


def _velodyne(model: str) -> tuple[float, ...]:
    return tuple(np.sort(np.rad2deg(built_in_table(model).elevation_rad)).round(3).tolist())


_PANDAR_LOW = (-25.0, -19.0, -14.0, -13.0, -12.0, -11.0, -10.0, -9.0, -8.0, -7.0)
_PANDAR_HIGH = (3.0, 5.0, 8.0, 11.0, 15.0)

LAYOUTS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "VLP-16": _velodyne("VLP-16"),
        "Puck Hi-Res": _velodyne("Puck Hi-Res"),
        "HDL-32E": _velodyne("HDL-32E"),
        "VLP-32C": _velodyne("VLP-32C"),
        # An upper block at a third of a degree, a lower one at half a degree (manual 63-HDL64ES3); each unit differs.
        "HDL-64E": _even(-24.33, -8.83, 32) + _even(-8.33, 2.0, 32),
        # Dense near the horizon, as the VLP-32C (63-9483).
        "VLS-128": (
            *(-25.0, -19.58, -16.04, -13.57, -11.74, -10.35, -9.24, -8.35, -7.65, -7.15),
            *_even(-6.85, 4.9, 108),
            *(5.2, 5.5, 5.9, 6.4, 7.0, 7.9, 9.0, 10.3, 12.2, 15.0),
        ),
        "OS0-64": _even(-45.0, 45.0, 64),
        "OS1-16": _even(-16.6, 16.6, 16),
        "OS1-32": _even(-22.5, 22.5, 32),
        "OS1-64": _even(-16.6, 16.6, 64),
        "OS1-128": _even(-22.5, 22.5, 128),
        "OS2-64": _even(-11.25, 11.25, 64),
        # A sixth of a degree from -6 to 2 degrees, wider outside (Pandar64 manual, appendix I).
        "Pandar64": (*_PANDAR_LOW, *_even(-6.0, 2.0, 49), *_PANDAR_HIGH),
        "Pandar40": (*_PANDAR_LOW, *_even(-6.0, 2.0, 25), *_PANDAR_HIGH),
        "PandarXT-32": _even(-16.0, 15.0, 32),
    }
)
"""By model, rising; spread evenly where a manual says no more than the limits."""
