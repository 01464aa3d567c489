import multiprocessing
import os
import signal
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenario import small_scenario

from lidcam.bags.simulator.recorder.processes import SensingProcess
from lidcam.bags.simulator.recorder.recorded import SensingTask
from lidcam.bags.simulator.recorder.sensing import Sensing
from lidcam.bags.simulator.recorder.stage import Stage
from lidcam.bags.simulator.recorder.start import shared_out
from lidcam.bags.simulator.scenario.scenario import Scenario, load_scenario
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.pipeline.core.errors import ConfigError, LidcamError

UNTIL_NS = 150_000_000


def task(**changes: object) -> SensingTask:
    scenario = Scenario.model_validate(small_scenario(**changes))
    return SensingTask(scenario, ("car1",), 1, ("top", "front"))


SCENARIOS = {name: load_scenario(name) for name in ("sandbox", "crossing", "vehicle")}


@given(st.sampled_from(sorted(SCENARIOS)), st.integers(1, 20))
def test_every_sensor_has_one_worker(name: str, workers: int) -> None:
    scenario = SCENARIOS[name]
    shares = shared_out(scenario, workers)
    assert 1 <= len(shares) <= workers
    assert all(shares)
    assert sorted(sensor for share in shares for sensor in share) == sorted([*scenario.lidars, *scenario.cameras])
    assert shared_out(Scenario(world="sandbox"), workers) == [()]


def test_a_process_measures_what_this_one_would_and_its_death_comes_out() -> None:
    commands = {"car1": AckermannCommand(0.3, 0.1)}
    stage = Stage(task().scenario, driven=("car1",))
    sensing = Sensing(stage, task())
    stage.traffic.command("car1", commands["car1"])
    stage.traffic.advance(UNTIL_NS)
    here = sensing.measure(UNTIL_NS, start_limit_ns=UNTIL_NS)
    with closing(SensingProcess(task())) as process:
        for number in (signal.SIGINT, signal.SIGHUP):  # Ctrl-C and a closed terminal are its parent's business
            os.kill(only_child(), number)
        process.ask(UNTIL_NS, commands, start_limit_ns=UNTIL_NS)
        there = process.answer()
        os.kill(only_child(), signal.SIGKILL)
        with pytest.raises(LidcamError, match="a simulation process died, perhaps for lack of memory"):
            ask_and_answer(process)
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) & {signal.SIGINT, signal.SIGHUP} == set()
    assert not multiprocessing.active_children()
    assert len(here) == len(there) > 1
    for mine, its in zip(here, there, strict=True):
        np.testing.assert_array_equal(mine.hits, its.hits)
        np.testing.assert_array_equal(mine.hit_offsets_ns, its.hit_offsets_ns)
        assert mine._replace(hits=its.hits, hit_offsets_ns=its.hit_offsets_ns) == its


def only_child() -> int:
    (child,) = multiprocessing.active_children()
    assert child.pid is not None
    return child.pid


def ask_and_answer(process: SensingProcess) -> None:
    process.ask(UNTIL_NS, {}, start_limit_ns=UNTIL_NS)
    process.answer()


def test_its_errors_come_out() -> None:
    wrong = task(vehicles__car2__route="", vehicles__car2__start=[-1.5, 1.35, 0])
    with (
        closing(SensingProcess(wrong)) as process,
        pytest.raises(ConfigError, match=r"vehicles\.car2: expected free ground"),
    ):
        ask_and_answer(process)
