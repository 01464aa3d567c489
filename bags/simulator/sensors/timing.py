"""When a sensor measures, what its clock says, and when its message is recorded or lost.

Times count nanoseconds of true time since the scenario began. Every measurement draws its random numbers from its own
generator, always the same ones in the same order, so that switching on one fault leaves all others as they were.
"""

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from bags.simulator.scenario.sensors import SensorScenario

__all__ = ["Measurement", "Timing", "random_numbers"]

MS = 1_000_000


def random_numbers(seed: int, name: str, purpose: str, number: int) -> np.random.Generator:
    """The generator of one measurement of one sensor, for one purpose."""
    return np.random.Generator(
        np.random.PCG64(np.random.SeedSequence([seed, crc32(name.encode()), crc32(purpose.encode()), number]))
    )


@dataclass(frozen=True, slots=True)
class Measurement:
    """One measurement of a sensor.

    Attributes:
        number: Counted from 0, also over lost ones.
        begin_ns: True time at which it begins.
        end_ns: True time at which it ends.
        stamp_ns: What the sensor's clock said at `begin_ns`.
        log_ns: True time at which its message is recorded.
        lost: Whether its message is lost.
    """

    number: int
    begin_ns: int
    end_ns: int
    stamp_ns: int
    log_ns: int
    lost: bool


@dataclass(frozen=True, slots=True)
class Timing:
    """The clock and the connection of one sensor.

    Attributes:
        name: Of the sensor.
        sensor: Its settings.
        seed: Of the scenario.
        trigger_jitter: Whether jitter moves the measurement itself (a camera's trigger) or, where the sensor turns
            evenly, only its stamp.
    """

    name: str
    sensor: SensorScenario
    seed: int
    trigger_jitter: bool

    @property
    def period_ns(self) -> int:
        """From one measurement to the next."""
        return round(1e9 / self.sensor.rate_hz)

    def nominal_ns(self, number: int) -> int:
        """When a measurement would begin without jitter."""
        return round(self.sensor.phase_ms * MS + number * 1e9 / self.sensor.rate_hz)

    def is_alive(self, begin_ns: int) -> bool:
        """Whether the sensor still measures."""
        return self.sensor.dies_at_s is None or begin_ns < self.sensor.dies_at_s * 1e9

    def measurement(
        self, number: int, *, begin_ns: int | None = None, end_ns: int | None = None, lasts_ns: int = 0
    ) -> Measurement:
        """One measurement.

        Args:
            number: Which one.
            begin_ns: When it begins, if the sensor itself knows better than its nominal rate.
            end_ns: When it ends; left out: `lasts_ns` after it began.
            lasts_ns: How long it takes.
        """
        random = random_numbers(self.seed, self.name, "timing", number)
        jitter_ns, delay_ns, luck = random.standard_normal(), random.standard_normal(), random.random()
        # A sensor measures in its order: a moment cannot pass the ones beside it.
        max_jitter_ns = 0.45 * self.period_ns
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
