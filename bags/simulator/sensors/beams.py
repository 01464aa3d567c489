"""Directions and times of the beams of a spinning lidar, sweep by sweep.

A Velodyne sweep consists of whole packets, from the first packet of its turn on. A `linear` lidar has `columns` firings
per turn, with its beams all at once, at equal steps or as listed. Both spin evenly with `rate_hz`, clockwise seen from
above.
"""

from math import ceil

import numpy as np

from lidcam.bags.simulator.scenario.sensors import LidarScenario
from lidcam.bags.simulator.sensors.velodyne_packets import Beams, EncodedPackets, VelodyneSensor
from lidcam.pipeline.core.arrays import F64, U8
from lidcam.readers.velodyne.models import MODELS, built_in_table

MS = 1_000_000
LINEAR_RANGE_STEP_M = 0.002


class VelodynePattern:
    """The beams of a Velodyne model with one bank of lasers."""

    def __init__(self, scenario: LidarScenario) -> None:
        self._sensor = VelodyneSensor(
            scenario.model,
            round(scenario.phase_ms * MS),
            scenario.rate_hz,
            scenario.start_azimuth_deg,
            scenario.return_mode,
        )
        self._stride = scenario.firing_stride
        self.elevation_rad: F64 = built_in_table(scenario.model).elevation_rad
        self.range_step_m = MODELS[scenario.model].range_step_m

    def begin_ns(self, number: int) -> int:
        """True time of the first firing of a sweep, where the one before it ends."""
        return self._sensor.packet_ns(self.packets(number).start)

    def packets(self, number: int) -> range:
        """Numbers of the packets of a sweep: those that start within its turn."""
        per_turn = self._sensor.packets_per_turn
        # Rounding must not move a packet that starts with the turn to the one before.
        return range(ceil(number * per_turn - 1e-6), ceil((number + 1) * per_turn - 1e-6))

    def beams(self, number: int) -> Beams:
        """The beams of a sweep."""
        packets = self.packets(number)
        beams = self._sensor.beams(packets.start, len(packets))
        kept = slice(-packets.start * self._sensor.firings_per_packet % self._stride, None, self._stride)
        return Beams(beams.directions[kept], beams.origins, beams.times_ns[kept], beams.azimuth_error_rad[kept])

    def encode(self, number: int, ranges_m: F64, reflectivity: U8) -> EncodedPackets:
        """The packets of a sweep, by a clock that started with the scenario; for a firing stride of 1.

        The arrays are (F, L), or (F, L, 2) of the last and the strongest return; a range of 0 is no return.
        """
        return self._sensor.encode(self.packets(number).start, ranges_m, reflectivity)


class LinearPattern:
    """Beams at any elevations, and firings at equal steps of azimuth."""

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
