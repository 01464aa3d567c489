import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.bags.simulator.scenario.sensors import SensorScenario
from lidcam.bags.simulator.sensors.timing import Timing

MS = 1_000_000


def timing(*, seed: int = 1, name: str = "s", trigger_jitter: bool = True, **settings: object) -> Timing:
    values = {"topic": "/t", "frame_id": "f", "position_m": (0, 0, 0), "log_delay_ms": 0.0} | settings
    return Timing(name, SensorScenario.model_validate(values), seed, trigger_jitter)


@pytest.mark.parametrize(("trigger_jitter", "moves"), [(True, True), (False, False)])
def test_jitter_moves_a_trigger_but_not_a_motor(trigger_jitter: bool, moves: bool) -> None:
    clock = timing(jitter_ms=2.0, phase_ms=50.0, trigger_jitter=trigger_jitter)
    found = [clock.measurement(number) for number in range(300)]
    begins = np.array([one.begin_ns - clock.nominal_ns(one.number) for one in found])
    stamps = np.array([one.stamp_ns - clock.nominal_ns(one.number) for one in found])
    assert begins.any() == moves
    np.testing.assert_allclose(stamps.std(), 2.0 * MS, rtol=0.15)
    if moves:
        np.testing.assert_array_equal(begins, stamps)


def test_drops_come_at_the_rate_that_was_asked_for() -> None:
    clock = timing(drop_rate=0.2)
    lost = sum(clock.measurement(number).lost for number in range(2000))
    assert 340 < lost < 460  # 400 +- 3.4 sigma


def test_a_message_is_recorded_after_its_measurement_ended() -> None:
    clock = timing(log_delay_ms=5.0, log_jitter_ms=4.0, trigger_jitter=False)
    delays = [clock.measurement(n, begin_ns=n, end_ns=100 * MS + n).log_ns - 100 * MS - n for n in range(500)]
    assert min(delays) == 0  # never before
    np.testing.assert_allclose(np.median(delays), 5.0 * MS, rtol=0.1)


@given(st.integers(0, 10_000), st.integers(0, 100), st.floats(0.1, 100))
def test_measurements_stay_in_their_order(number: int, jitter_ms: int, rate_hz: float) -> None:
    clock = timing(jitter_ms=jitter_ms, rate_hz=rate_hz)
    assert clock.measurement(number).begin_ns < clock.measurement(number + 1).begin_ns


@given(st.integers(0, 1000), st.integers(0, 10).map(lambda n: n / 10), st.integers(0, 10), st.integers(-50, 50))
def test_one_fault_leaves_the_others_as_they_were(number: int, drop: float, jitter: int, offset: int) -> None:
    plain = timing(jitter_ms=3.0, drop_rate=0.3, log_jitter_ms=1.0, log_delay_ms=9.0)
    first = plain.measurement(number)
    other = timing(jitter_ms=3.0, drop_rate=drop, log_jitter_ms=1.0, log_delay_ms=9.0).measurement(number)
    assert (other.begin_ns, other.stamp_ns, other.log_ns) == (first.begin_ns, first.stamp_ns, first.log_ns)
    late = timing(jitter_ms=jitter, drop_rate=0.3, log_jitter_ms=1.0, log_delay_ms=9.0, clock_offset_ms=offset)
    found = late.measurement(number)
    assert (found.lost, found.log_ns - found.end_ns) == (first.lost, first.log_ns - first.end_ns)
