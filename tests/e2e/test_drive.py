"""`lidcam drive` through a pseudo-terminal, as somebody at a keyboard has it."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import Lidcam
from rosbags.highlevel import AnyReader
from small_scenario import write_small_scenario

from pipeline.core.ros.typestores import message_types

PROGRAM = Path(sys.executable).with_name("lidcam")
STARTED_S = 60.0


@dataclass
class Driver:
    """Somebody at a terminal in which `lidcam drive` runs."""

    hand: int
    terminal: int
    process: subprocess.Popen[bytes]
    output: Path
    before: list[Any]
    shown: bytes = b""

    def wait_for(self, text: bytes) -> None:
        """Until the program has shown something."""
        end = time.monotonic() + STARTED_S
        while text not in self.shown:
            assert time.monotonic() < end, self.shown
            assert self.process.poll() is None, self.shown
            self.shown += os.read(self.hand, 4096)

    def press(self, key: str) -> None:
        """Press a key, and look on until the simulation has gone on with it."""
        while select.select([self.hand], [], [], 0)[0]:  # what was shown before the key, which may be a while ago
            self.shown += os.read(self.hand, 4096)
        os.write(self.hand, key.encode())
        end, begin_s = time.monotonic() + STARTED_S, self.now_s()
        while self.now_s() < begin_s + 0.3:
            assert time.monotonic() < end, self.shown
            self.shown += os.read(self.hand, 4096)

    def now_s(self) -> float:
        """How far the simulation has gone, as it is shown."""
        return float(re.findall(rb"\r *([\d.]+) s ", self.shown)[-1])

    def leave(self) -> int:
        """The exit code, once it has ended by itself."""
        end = time.monotonic() + STARTED_S
        os.set_blocking(self.hand, False)
        while self.process.poll() is None:
            assert time.monotonic() < end, self.shown
            try:
                self.shown += os.read(self.hand, 4096)
            except OSError:  # nothing there, or nobody
                time.sleep(0.02)
        return self.process.returncode


@pytest.fixture
def driver(tmp_path: Path) -> Iterator[Driver]:
    scenario = write_small_scenario(tmp_path / "small.yaml")
    hand, terminal = pty.openpty()
    before = termios.tcgetattr(terminal)
    command = [str(PROGRAM), "drive", str(scenario), str(tmp_path / "out.bag")]
    process = subprocess.Popen(
        command, stdin=terminal, stdout=terminal, stderr=terminal, cwd=tmp_path, start_new_session=True
    )
    yield Driver(hand, terminal, process, tmp_path / "out.bag", before)
    process.kill()
    process.wait()
    for descriptor in (hand, terminal):
        try:
            os.close(descriptor)
        except OSError:
            continue


def drives(path: Path, car: str) -> list[tuple[float, float]]:
    """Speed and steering of a car's commands, each once as long as it holds."""
    with AnyReader([path], default_typestore=message_types(1)) as reader:
        wanted = [c for c in reader.connections if c.topic == f"/{car}/ackermann_cmd_mux/output"]
        found: list[Any] = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(wanted)]
    told = [
        (round(float(one.speed), 3), round(float(one.steering_angle), 3))
        for one in (message.drive for message in found)
    ]
    return [one for number, one in enumerate(told) if number == 0 or told[number - 1] != one]


@pytest.mark.traced_processes
def test_all_keys(driver: Driver) -> None:
    driver.wait_for(b"car1 at")
    for key in "wasdx2w1w":
        driver.press(key)
    os.write(driver.hand, b"o")
    assert driver.leave() == 0
    assert b"wrote" in driver.shown
    assert b"Traceback" not in driver.shown
    assert termios.tcgetattr(driver.terminal) == driver.before
    forward, left, right = (0.3, 0.0), (0.3, 0.49), (0.3, -0.49)
    assert drives(driver.output, "car1") == [(0, 0), forward, left, (-0.3, 0), right, (0, 0), forward]
    assert drives(driver.output, "car2") == [(0, 0), forward]


@pytest.mark.parametrize("ending", ["ctrl-c", "ctrl-d"])
def test_other_endings_keep_the_recording(driver: Driver, ending: str) -> None:
    driver.wait_for(b"car1 at")
    driver.press("w")
    if ending == "ctrl-c":
        os.killpg(driver.process.pid, signal.SIGINT)  # what a terminal makes of the key, where it controls the process
    else:
        os.write(driver.hand, b"\x04")
    assert driver.leave() == 0
    assert b"Traceback" not in driver.shown
    assert termios.tcgetattr(driver.terminal) == driver.before
    assert (0.3, 0.0) in drives(driver.output, "car1")


@pytest.mark.traced_processes
def test_a_lost_terminal_keeps_the_recording(driver: Driver) -> None:
    driver.wait_for(b"car1 at")
    driver.press("w")
    os.close(driver.terminal)
    os.close(driver.hand)
    assert driver.process.wait(STARTED_S) == 0
    assert (0.3, 0.0) in drives(driver.output, "car1")


def test_scripted_keys_give_the_same_bytes_each_time(lidcam: Lidcam, tmp_path: Path) -> None:
    scenario = write_small_scenario(tmp_path / "small.yaml")
    for name in ("a.mcap", "b.mcap"):
        done = lidcam("drive", scenario, tmp_path / name, "--keys", "wa2w", "--key-interval", 0.3)
        assert done.code == 0, done.err
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    done = lidcam("drive", scenario, tmp_path / "c.bag", "--keys", "wdoww", "--key-interval", 0.3)
    assert done.code == 0, done.err
    assert "0.6 s" in done.err  # nothing after the key to quit
    assert drives(tmp_path / "c.bag", "car1") == [(0.3, 0.0), (0.3, -0.49)]


def test_a_wall_stops_a_car(lidcam: Lidcam, tmp_path: Path) -> None:
    scenario = write_small_scenario(tmp_path / "small.yaml", vehicles__car1__start=[-1.3, 1.2, 180])
    done = lidcam("drive", scenario, tmp_path / "out.bag", "--keys", "wwww", "--key-interval", 1.0)
    assert done.code == 0, done.err
    with AnyReader([tmp_path / "out.bag"]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/car1/base_pose_ground_truth"]
        found: list[Any] = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(wanted)]
    x = np.array([message.pose.pose.position.x for message in found])
    assert x.min() > -2.0 + 0.165  # the table ends at -2
    assert x[-1] == x[-10]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("vehicle", "out.bag", "--keys", "w"), 1, "expected a vehicle with `commands: true` to drive"),
        (("sandbox", "out.bag", "--key-interval", "0"), 2, "key-interval"),
        (("sandbox", "out.bag", "--keys", "hello"), 1, "keys: expected w s a d x 1 2 o . (. waits), found 'h'"),
    ],
)
def test_what_cannot_be_driven(lidcam: Lidcam, arguments: tuple[str, ...], code: int, message: str) -> None:
    done = lidcam("drive", *arguments)
    assert done.code == code
    assert message in (done.error_line if code == 1 else done.err)
