"""The ground as compiled functions take it."""

from typing import NamedTuple, Self

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.clouds import CombinedCloud

__all__ = ["Ground"]


class Ground(NamedTuple):
    """A plane and how the ground differs from it, in the site frame.

    Attributes:
        plane: (4,) float64 normal and offset of the plane, see `Plane`.
        relief_m: (H, W) float64 height above the plane, see `Relief`.
        grid: (3,) float64 place of the first node of `relief_m`, and the distance between nodes, metres.
    """

    plane: F64
    relief_m: F64
    grid: F64

    @classmethod
    def of(cls, combined: CombinedCloud, *, level_m: float) -> Self:
        """That of a cloud, as `CombinedCloud.ground_m`."""
        if combined.plane is None:
            return cls.level(level_m)
        plane = np.append(combined.plane.normal, combined.plane.offset_m)
        if combined.relief is None:
            return cls(plane, *_no_relief())
        return cls(plane, combined.relief.offsets_m, np.append(combined.relief.origin_xy, combined.relief.cell_m))

    @classmethod
    def level(cls, height_m: float) -> Self:
        """Level ground."""
        return cls(np.array([0.0, 0.0, 1.0, -height_m]), *_no_relief())


def _no_relief() -> tuple[F64, F64]:
    return np.zeros((2, 2)), np.array([0.0, 0.0, 1.0])
