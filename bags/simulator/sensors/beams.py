"""Beams of spinning lidars: directions and times, sweep by sweep, and Velodyne's data packets from ranges.

A Velodyne sweep consists of whole packets, from the first packet of its turn on. A `linear` lidar has `columns` firings
per turn, with its beams all at once, at equal steps or as listed. Both spin evenly, clockwise seen from above. Packets
are the inverse of `lidcam.readers.velodyne.decoder`, written independently. As in the manuals, block azimuths are
rounded to 0.01 degrees, packet times to microseconds, ranges to the model's step.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np

from lidcam.bags.simulator.scenario.sensors import LidarScenario
from lidcam.pipeline.core.arrays import F64, I64, U8, U16
from lidcam.readers.velodyne.models import BLOCK_FLAGS, MODELS, built_in_table

MS = 1_000_000
LINEAR_RANGE_STEP_M = 0.002
BLOCKS, SLOTS = 12, 32  # of a packet, and of a block
RETURN_BYTES = {"strongest": 0x37, "last": 0x38, "dual": 0x39}

_ECHO = [("steps", "<u2"), ("reflectivity", "u1")]
_BLOCK = [("flag", "<u2"), ("azimuth", "<u2"), ("echoes", _ECHO, SLOTS)]
_PACKET = np.dtype([("blocks", _BLOCK, BLOCKS), ("time_us", "<u4"), ("mode", "u1"), ("product", "u1")])


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The beams of consecutive firings, in the sensor's frame (x ahead, y to the left, z up)."""

    directions: F64  # (F, L, 3) unit vectors, by firing and laser id
    origins: F64  # (L, 3) metres, where the beams of each laser start on the axis
    times_ns: I64  # (F, L)
    azimuth_error_rad: F64  # (F,) azimuths that a decoder computes from packets minus the true ones

    @property
    def measured_directions(self) -> F64:
        """(F, L, 3) reported directions; unit vectors to 1e-8."""
        error, measured = self.azimuth_error_rad[:, None], self.directions.copy()
        measured[:, :, 0] += error * self.directions[:, :, 1]
        measured[:, :, 1] -= error * self.directions[:, :, 0]
        return measured


@dataclass(frozen=True, slots=True, eq=False)
class EncodedPackets:
    """Data packets."""

    stamps_ns: I64  # (P,) time of the first firing
    payload: U8  # (P, 1206)

    def later(self, by_ns: int) -> "EncodedPackets":
        """The same packets at a later time, in their internal clock (microseconds of the hour), too."""
        stamps_ns = self.stamps_ns + by_ns
        payload = self.payload.copy()
        payload[:, 1200:1204] = _hour_us(stamps_ns).astype("<u4").view(np.uint8).reshape(-1, 4)
        return EncodedPackets(stamps_ns, payload)


class VelodynePattern:
    """The sweeps of an evenly spinning Velodyne with one bank of lasers; packets count from its first firing."""

    def __init__(self, scenario: LidarScenario) -> None:
        self._scenario, self._start_ns = scenario, round(scenario.phase_ms * MS)
        self._facts, self._table = MODELS[scenario.model], built_in_table(scenario.model)
        self.elevation_rad: F64 = self._table.elevation_rad
        self.range_step_m = self._facts.range_step_m
        self._columns = BLOCKS // (2 if scenario.return_mode == "dual" else 1)
        self._firings_per_block = SLOTS // self._facts.lasers
        self._packet_us = self._facts.column_us * self._columns
        self._laser_us = np.array(self._facts.slot_us[0][: self._facts.lasers], np.float64)  # since the firing began
        self._turn_rad_us = 2 * np.pi * scenario.rate_hz * 1e-6

    def begin_ns(self, number: int) -> int:
        """True time of the first firing of a sweep, where the one before it ends."""
        first, _ = self._first_and_count(number)
        return self._start_ns + round(first * self._packet_us * 1000)

    def _first_and_count(self, number: int) -> tuple[int, int]:
        """The first packet of a sweep, and the number of its packets: those that start within its turn."""
        per_turn: float = 1e6 / self._scenario.rate_hz / self._packet_us  # usually not a whole number
        # Rounding must not move a packet that starts with the turn to the one before.
        first, end = (ceil(turn * per_turn - 1e-6) for turn in (number, number + 1))
        return first, end - first

    def beams(self, number: int) -> Beams:
        """The beams of a sweep."""
        firing_us, table = self._firing_us(number), self._table
        # An azimuth is the sum of one per firing and one per laser: cosine and sine are only needed of these.
        firing = self._azimuth_rad(firing_us)[:, None]
        laser = self._turn_rad_us * self._laser_us - table.azimuth_offset_rad
        across = np.cos(table.elevation_rad)
        cos, sin = across * np.cos(laser), across * np.sin(laser)
        directions = np.empty((len(firing), len(table), 3))
        directions[:, :, 0] = np.cos(firing) * cos - np.sin(firing) * sin
        directions[:, :, 1] = -np.sin(firing) * cos - np.cos(firing) * sin
        directions[:, :, 2] = np.sin(table.elevation_rad)
        origins = np.stack([np.zeros(len(table)), np.zeros(len(table)), table.vertical_offset_m], axis=-1)
        times_us = firing_us[:, None] + self._laser_us
        times_ns = self._start_ns + np.rint(times_us * 1000).astype(np.int64)
        # Packets round the azimuth of each block to 0.01 degrees; the error carries over to its second firing.
        true_deg = np.rad2deg(self._azimuth_rad(self._block_us(number).reshape(-1)))
        error_rad = np.repeat(np.deg2rad(np.rint(true_deg * 100) / 100 - true_deg), self._firings_per_block)
        first_packet, _ = self._first_and_count(number)
        stride = self._scenario.firing_stride
        kept = slice(-first_packet * self._columns * self._firings_per_block % stride, None, stride)
        return Beams(directions[kept], origins, times_ns[kept], error_rad[kept])

    def encode(self, number: int, ranges_m: F64, reflectivity: U8) -> EncodedPackets:
        """The packets of a sweep with the ranges along its beams.

        Args:
            number: The sweep.
            ranges_m: (F, L) metres by firing and laser id; in dual mode (F, L, 2), the last return, then the strongest.
                Values that are not finite, not positive or too large are no return.
            reflectivity: Like `ranges_m`.
        """
        times_us, returns = self._block_us(number), BLOCKS // self._columns
        with np.errstate(invalid="ignore"):
            steps = np.rint(ranges_m / self._facts.range_step_m)
            steps = np.where((steps > 0) & (steps <= 0xFFFF), steps, 0).astype(np.uint16)
        azimuth = np.rint(np.rad2deg(self._azimuth_rad(times_us)) * 100).astype(np.int64) % 36000

        def by_return(values: U16 | U8) -> U16 | U8:
            """In block layout: (packets, columns, returns, 32)."""
            return np.moveaxis(values.reshape(-1, self._columns, SLOTS, returns), 3, 2)

        table = np.zeros(len(times_us), _PACKET)
        blocks = table["blocks"].reshape(-1, self._columns, returns)
        blocks["flag"] = BLOCK_FLAGS[0]
        blocks["azimuth"] = azimuth[:, :, None]
        blocks["echoes"]["steps"] = by_return(steps)
        blocks["echoes"]["reflectivity"] = by_return(np.where(steps, reflectivity, 0))
        stamps_ns = self._start_ns + np.rint(times_us[:, 0] * 1000).astype(np.int64)
        table["time_us"] = _hour_us(stamps_ns)
        table["mode"] = RETURN_BYTES[self._scenario.return_mode]
        table["product"] = self._facts.product
        return EncodedPackets(stamps_ns, np.frombuffer(table.tobytes(), np.uint8).reshape(len(table), -1))

    def _firing_us(self, number: int) -> F64:
        """(F,) times of the firings of a sweep, since the first one of all."""
        first, count = self._first_and_count(number)
        packet_us = (first + np.arange(count)) * self._packet_us
        slot_us = self._facts.slot_us[0][:: self._facts.lasers][: self._firings_per_block]
        block_us = np.arange(self._columns) * self._facts.column_us
        return np.asarray((packet_us[:, None, None] + block_us[:, None] + np.array(slot_us, np.float64)).reshape(-1))

    def _block_us(self, number: int) -> F64:
        """(packets, columns) times of the first firing of each block."""
        return self._firing_us(number).reshape(-1, self._columns, self._firings_per_block)[:, :, 0]

    def _azimuth_rad(self, times_us: F64) -> F64:
        return np.asarray(np.deg2rad(self._scenario.start_azimuth_deg) + self._turn_rad_us * times_us)


def _hour_us(stamps_ns: I64) -> I64:
    """Microseconds since the full hour, rounded."""
    return (stamps_ns + 500) // 1000 % 3_600_000_000


class LinearPattern:
    """The sweeps of a lidar with beams at any elevations, and firings at equal steps of azimuth."""

    def __init__(self, scenario: LidarScenario) -> None:
        self._scenario = scenario
        self.elevation_rad: F64 = np.deg2rad(scenario.linear_elevations_deg)
        self.range_step_m = LINEAR_RANGE_STEP_M

    def begin_ns(self, number: int) -> int:
        """True start time of a sweep, where the one before it ends."""
        return round(self._scenario.phase_ms * MS + number * 1e9 / self._scenario.rate_hz)

    def beams(self, number: int) -> Beams:
        """The beams of a sweep."""
        columns, lasers = self._scenario.columns, len(self.elevation_rad)
        stride = self._scenario.firing_stride
        column = np.arange(-number * columns % stride, columns, stride)
        azimuth = np.deg2rad(self._scenario.start_azimuth_deg) + 2 * np.pi / columns * column
        across = np.cos(self.elevation_rad)
        directions = np.empty((len(column), lasers, 3))
        directions[:, :, 0] = np.cos(azimuth)[:, None] * across
        directions[:, :, 1] = -np.sin(azimuth)[:, None] * across
        directions[:, :, 2] = np.sin(self.elevation_rad)
        turns_ns = (number + column / columns) * (1e9 / self._scenario.rate_hz)
        times_ns = np.rint(self._scenario.phase_ms * MS + turns_ns).astype(np.int64)
        times_ns = np.broadcast_to(times_ns[:, None], (len(column), lasers))
        return Beams(directions, np.zeros((lasers, 3)), times_ns, np.zeros(len(column)))


def pattern_of(scenario: LidarScenario) -> LinearPattern | VelodynePattern:
    """The beam pattern of a lidar."""
    return LinearPattern(scenario) if scenario.model == "linear" else VelodynePattern(scenario)
