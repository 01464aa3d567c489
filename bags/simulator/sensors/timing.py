"""Measurement times, stamps, recording times and losses of a sensor.

Times are nanoseconds of true time since the start of the scenario. Each measurement has its own random generator and
draws the same numbers in the same order, so switching on one fault leaves all others unchanged.
"""

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.scenario.sensors import SensorScenario

MS = 1_000_000


def random_numbers(seed: int, name: str, purpose: str, number: int) -> np.random.Generator:
    """The random generator of one measurement of one sensor, for one purpose."""
    seeds = [seed, crc32(name.encode()), crc32(purpose.encode()), number]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seeds)))


@dataclass(frozen=True, slots=True)
class Measurement:
    """One measurement of a sensor."""

    number: int  # counted from 0, lost ones included
    begin_ns: int
    end_ns: int
    stamp_ns: int  # the sensor's clock at `begin_ns`
    log_ns: int  # when its message is recorded
    lost: bool


@dataclass(frozen=True, slots=True)
class Timing:
    """Clock and connection of one sensor."""

    name: str
    sensor: SensorScenario
    seed: int
    trigger_jitter: bool  # jitter shifts the measurement itself (a camera's trigger), not only its stamp (a lidar)

    @property
    def period_ns(self) -> int:
        """From one measurement to the next."""
        return round(1e9 / self.sensor.rate_hz)

    def nominal_ns(self, number: int) -> int:
        """Start of a measurement without jitter."""
        return round(self.sensor.phase_ms * MS + number * 1e9 / self.sensor.rate_hz)

    def is_alive(self, begin_ns: int) -> bool:
        """Whether the sensor still works at a time."""
        return self.sensor.dies_at_s is None or begin_ns < self.sensor.dies_at_s * 1e9

    def measurement(
        self, number: int, *, begin_ns: int | None = None, end_ns: int | None = None, lasts_ns: int = 0
    ) -> Measurement:
        """One measurement: from its nominal start unless another is given, to `lasts_ns` later unless its end is."""
        random = random_numbers(self.seed, self.name, "timing", number)
        jitter_ns, delay_ns, luck = random.standard_normal(), random.standard_normal(), random.random()
        max_jitter_ns = 0.45 * self.period_ns  # measurements stay in order
        jitter_ns = round(np.clip(jitter_ns * self.sensor.jitter_ms * MS, -max_jitter_ns, max_jitter_ns))
        begin = self.nominal_ns(number) if begin_ns is None else begin_ns
        stamp = begin + round(self.sensor.clock_offset_ms * MS)
        if self.trigger_jitter:
            begin, stamp = max(begin + jitter_ns, 0), max(begin + jitter_ns, 0) + stamp - begin
        else:
            stamp += jitter_ns
        end = begin + lasts_ns if end_ns is None else end_ns
        delay_ms = max(self.sensor.log_delay_ms + delay_ns * self.sensor.log_jitter_ms, 0.0)
        return Measurement(number, begin, end, stamp, end + round(delay_ms * MS), luck < self.sensor.drop_rate)
