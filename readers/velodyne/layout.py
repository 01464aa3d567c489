"""The layout of a Velodyne's packet: which block holds which lasers, columns and returns."""

from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import Indices
from readers.velodyne.models import BLOCK_FLAGS, LaserTable, VelodyneModel
from readers.velodyne.scan import SLOTS

__all__ = ["BOTH", "LAST", "NOT_TOLD", "STRONGEST", "Beams", "Layout"]

# `PointCloud.return_type`
NOT_TOLD = 0
STRONGEST = 1
LAST = 2
BOTH = 3


class Layout(NamedTuple):
    """The order of the blocks in a packet.

    Attributes:
        columns: Number of columns.
        banks: Number of banks.
        returns: Types of the returns of a firing, in the order of their blocks.
        apart: Blocks from a return to the next one of the same firing.
    """

    columns: int
    banks: int
    returns: tuple[int, ...]
    apart: int = 1

    @property
    def blocks(self) -> int:
        """Number of blocks in use."""
        return self.columns * self.banks * len(self.returns)

    @property
    def block_of_firing(self) -> Indices:
        """(columns, banks): block of the first return."""
        column, bank = np.arange(self.columns)[:, None], np.arange(self.banks)
        between = len(self.returns) if self.apart == 1 else 1
        return np.asarray(column * self.banks * len(self.returns) + bank * between)


class Beams:
    """Lookup tables of one model, calibration and layout; those by place in the column have the shape (banks * 32,)."""

    def __init__(self, model: VelodyneModel, table: LaserTable, layout: Layout) -> None:
        place = np.arange(model.banks * SLOTS)
        laser = place % model.lasers
        slot_us = np.array(model.slot_us, np.float64).reshape(-1)
        column_us = np.arange(layout.columns) * model.column_us + model.first_us
        self.model = model
        self.layout = layout
        self.laser = laser
        self.slot_us = slot_us.astype(np.float32)
        self.firing_ns = np.rint((column_us[:, None] + slot_us).reshape(-1) * 1000).astype(np.int32)
        self.blocks = layout.block_of_firing
        self.flags = np.array(BLOCK_FLAGS[: model.banks], np.uint16)
        self.azimuth_offset_rad = table.azimuth_offset_rad[laser].astype(np.float32)
        self.cos_elevation = np.cos(table.elevation_rad)[laser].astype(np.float32)
        self.sin_elevation = np.sin(table.elevation_rad)[laser].astype(np.float32)
        self.vertical_offset_m = table.vertical_offset_m[laser].astype(np.float32)
        self.ring = table.rings[laser]
        self.corrections = table.corrections
