"""Points from the ranges of Velodyne packets: which block holds which lasers, azimuths, calibration, times."""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, U8, U16, Array, Indices
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.readers.velodyne.models import BLOCK_FLAGS, LaserTable, RangeCorrections, VelodyneModel
from lidcam.readers.velodyne.scan import RANGES_PER_BLOCK, VelodynePackets

# `PointCloud.return_type`
UNKNOWN_RETURN = 0
STRONGEST = 1
LAST = 2
BOTH = 3

# The HDL-64E's two calibration distances (manual, appendix E).
FAR_M, NEAR_X_M, NEAR_Y_M = 25.04, 2.40, 1.93


class Layout(NamedTuple):
    """The order of the blocks in a packet."""

    columns: int  # Number of columns
    banks: int  # Number of banks
    returns: tuple[int, ...]  # Types of the returns of a firing, in the order of their blocks
    apart: int = 1  # Blocks from a return to the next one of the same firing

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
        place = np.arange(model.banks * RANGES_PER_BLOCK)
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


def cloud_of(packets: VelodynePackets, beams: Beams, device_us: I64, packet_ns: I64, stamp_ns: int) -> PointCloud:
    """The points of packets (one or more) that all have the layout of `beams`.

    The times of the packets (P,) are by the sensor's clock, from any origin, and after `stamp_ns`, the cloud's stamp.
    """
    layout = beams.layout
    blocks = packets.fields["blocks"][:, : layout.blocks]
    steps = blocks["echoes"]["range"].reshape(-1)
    kept, firing, return_type = _measured(steps, len(blocks), layout)
    place = firing % (layout.banks * RANGES_PER_BLOCK)
    cos_azimuth, sin_azimuth = (grid.reshape(-1).take(firing) for grid in _headings(blocks, beams, device_us))
    steps = steps.take(kept)
    range_m = steps.astype(np.float32)
    range_m *= np.float32(beams.model.range_step_m)
    intensity = blocks["echoes"]["reflectivity"].reshape(-1).take(kept).astype(np.float32)
    if beams.corrections is None:
        xyz = _points(beams, place, range_m, cos_azimuth, sin_azimuth)
    else:
        xyz = _corrected_points(beams, beams.corrections, place, range_m, cos_azimuth, sin_azimuth)
        intensity = _corrected_intensity(beams.corrections, beams.laser[place], steps, intensity)
    times_ns = packet_ns.astype(np.int32)[:, None] + beams.firing_ns
    return PointCloud(
        stamp_ns=stamp_ns,
        frame_id=packets.frame_id,
        xyz=xyz,
        intensity=intensity,
        ring=beams.ring.take(place),
        time_offset_ns=times_ns.reshape(-1).take(firing),
        has_time=True,
        return_type=return_type,
    )


def _measured(steps: U16, packets: int, layout: Layout) -> tuple[Indices, Indices, U8]:
    """Indices of the ranges that become points; the firing of each in (P, columns, banks, 32); types of the returns."""
    measured = steps != 0
    if len(layout.returns) == 1:
        kept = np.flatnonzero(measured)
        return kept, kept, np.full(len(kept), layout.returns[0], np.uint8)
    pairs = steps.reshape(packets, -1, 2, layout.apart * RANGES_PER_BLOCK)  # both returns of a firing
    firings = np.arange(len(steps) // 2).reshape(packets, -1, 1, layout.apart * RANGES_PER_BLOCK)
    equal = pairs[:, :, 0] == pairs[:, :, 1]
    strongest, last = layout.returns.index(STRONGEST), layout.returns.index(LAST)
    types = np.empty(pairs.shape, np.uint8)
    types[:, :, strongest] = np.where(equal, np.uint8(BOTH), np.uint8(STRONGEST))
    types[:, :, last] = LAST
    measured.reshape(pairs.shape)[:, :, last] &= ~equal
    kept = np.flatnonzero(measured)
    return kept, np.broadcast_to(firings, pairs.shape).reshape(-1).take(kept), types.reshape(-1).take(kept)


def _headings(blocks: Array, beams: Beams, device_us: I64) -> tuple[F32, F32]:
    """Cosine and sine of the azimuth of every firing, (P, columns, banks, 32).

    The azimuth is that of the block plus a small angle that all blocks of a packet share: by the angle addition
    formulas only the two parts need cosine and sine.
    """
    layout = beams.layout
    azimuth = blocks["azimuth"][:, beams.blocks]
    rate = _turn_rate(azimuth[:, :, 0].astype(np.int64), beams.model, device_us).astype(np.float32)
    small = (rate[:, None] * beams.slot_us - beams.azimuth_offset_rad).reshape(-1, 1, layout.banks, RANGES_PER_BLOCK)
    block = azimuth.astype(np.float32)[..., None] * np.float32(np.pi / 18000)
    cos_small, sin_small, cos_block, sin_block = np.cos(small), np.sin(small), np.cos(block), np.sin(block)
    return cos_block * cos_small - sin_block * sin_small, sin_block * cos_small + cos_block * sin_small


def _turn_rate(azimuth: I64, model: VelodyneModel, device_us: I64) -> F64:
    """(P,) radians per microsecond, from azimuths (P, columns) in hundredths of a degree."""
    columns = azimuth.shape[1]
    if model.banks < 4 or (len(azimuth) == 1 and columns > 1):
        turned = _turn(azimuth[:, 0], azimuth[:, -1]) / ((columns - 1) * model.column_us)
    elif len(azimuth) == 1:
        turned = np.zeros(1)  # unknown from a single column
    else:
        period_us = columns * model.column_us
        between = np.rint(np.diff(device_us) / period_us)  # negative behind a packet that was overtaken
        turned = _turn(azimuth[:-1, 0], azimuth[1:, 0]) / (np.where(between == 0, 1, between) * period_us)
        turned = np.concatenate([turned[:1], turned])
    return np.asarray(turned * (np.pi / 18000))


def _turn(before: I64, after: I64) -> I64:
    """The smaller turn from one azimuth to another, hundredths of a degree."""
    return (after - before + 18000) % 36000 - 18000


def _points(beams: Beams, place: Indices, range_m: F32, cos_azimuth: F32, sin_azimuth: F32) -> F32:
    """(n, 3): x ahead at azimuth 0, y to the left, against the sense of the azimuth, z up."""
    horizontal_m = range_m * beams.cos_elevation.take(place)
    height_m = range_m * beams.sin_elevation.take(place) + beams.vertical_offset_m.take(place)
    return np.stack([horizontal_m * cos_azimuth, -horizontal_m * sin_azimuth, height_m], axis=1)


def _corrected_points(
    beams: Beams, corrections: RangeCorrections, place: Indices, range_m: F32, cos_azimuth: F32, sin_azimuth: F32
) -> F32:
    """Points like those of `_points`, with the two-point calibration of the HDL-64E (manual, appendix E).

    z uses the mean of the corrections of x and y, as in velodyne_decoder; the manual uses that of y.
    """
    laser = beams.laser[place]
    cos_elevation, sin_elevation = beams.cos_elevation.take(place), beams.sin_elevation.take(place)
    used = corrections.far_m, corrections.near_x_m, corrections.near_y_m, corrections.horizontal_offset_m
    far_m, near_x_m, near_y_m, beside_m = (values.astype(np.float32).take(laser) for values in used)
    across_m = (range_m + far_m) * cos_elevation
    two_points = (near_x_m != 0) & (near_y_m != 0) & (range_m < FAR_M)
    weight_x = np.where(two_points, (np.abs(across_m * sin_azimuth) - NEAR_X_M) / (FAR_M - NEAR_X_M), np.float32(1))
    weight_y = np.where(two_points, (np.abs(across_m * cos_azimuth) - NEAR_Y_M) / (FAR_M - NEAR_Y_M), np.float32(1))
    add_x = weight_x * far_m + (1 - weight_x) * near_x_m
    add_y = weight_y * far_m + (1 - weight_y) * near_y_m
    x = (range_m + add_y) * cos_elevation * cos_azimuth + beside_m * sin_azimuth
    y = beside_m * cos_azimuth - (range_m + add_x) * cos_elevation * sin_azimuth
    z = (range_m + (add_x + add_y) / 2) * sin_elevation + beams.vertical_offset_m.take(place)
    return np.stack([x, y, z], axis=1)


def _corrected_intensity(corrections: RangeCorrections, laser: Indices, steps: U16, reflectivity: F32) -> F32:
    focus = (1 - corrections.focal_distance[laser] / 131) ** 2
    added = 256 * corrections.focal_slope[laser] * np.abs(focus - (1 - steps / 65535) ** 2)
    lowest, highest = corrections.min_intensity[laser], corrections.max_intensity[laser]
    return np.clip(reflectivity + added, lowest, highest).astype(np.float32)
