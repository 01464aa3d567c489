"""The colours of all outputs: an object looks the same in every viewer."""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import Array, Indices


class Rgb(NamedTuple):
    """Red, green and blue in [0, 1]."""

    r: float
    g: float
    b: float

    @property
    def bytes_rgb(self) -> tuple[int, int, int]:
        """The same as integers from 0 to 255."""
        return round(self.r * 255), round(self.g * 255), round(self.b * 255)


# Distinct on a dark background and to the colour-blind (Okabe and Ito, jfly.uni-koeln.de/color, lightened).
_CLASS_COLORS = (
    Rgb(0.34, 0.71, 0.98),
    Rgb(0.98, 0.52, 0.18),
    Rgb(0.88, 0.56, 0.85),
    Rgb(0.10, 0.78, 0.62),
    Rgb(0.96, 0.88, 0.30),
    Rgb(0.80, 0.80, 0.80),
)

TRUTH = Rgb(0.88, 0.90, 0.93)
"""A box of the truth: brighter than any class, and drawn by its edges alone."""

MATCHED = Rgb(0.20, 0.95, 0.35)
"""A 2D box that belongs to an object."""

CAMERA_ONLY = Rgb(1.00, 0.76, 0.10)
"""A 2D box of no object."""

ZONE = Rgb(0.62, 0.58, 0.86)
"""The outline of a zone on the ground."""


def class_color(class_id: int) -> Rgb:
    """Colour of a class; colours repeat after the sixth."""
    return _CLASS_COLORS[class_id % len(_CLASS_COLORS)]


GROUND = (70, 76, 86)
"""A point of the ground, red, green, blue from 0 to 255."""

# Low to high; muted, so that the boxes stand out from the cloud.
_HEIGHT_STOPS = np.array([[62, 84, 128], [108, 150, 190], [176, 205, 218], [245, 240, 225]], np.float64)


_SHARES, _STOPS_AT = np.linspace(0, 1, 1024), np.linspace(0, 1, len(_HEIGHT_STOPS))
HEIGHT_COLORS = np.stack([np.interp(_SHARES, _STOPS_AT, one).astype(np.uint8) for one in _HEIGHT_STOPS.T], 1)
"""(1024, 3) colours of heights, from low to high; looked up, as three interpolations of all points take longest."""


def height_rows(z: Array, heights: tuple[float, float]) -> Indices:
    """(N,) rows of `HEIGHT_COLORS` of points at heights (N,), where the colours run from the first to the second."""
    share = (z - heights[0]) / (heights[1] - heights[0])
    return (np.clip(share, 0.0, 1.0) * (len(HEIGHT_COLORS) - 1) + 0.5).astype(np.intp)
