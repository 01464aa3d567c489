"""`lidcam drive` through a pseudo-terminal, as somebody at a keyboard has it, and `lidcam simulate`."""

import os
import pty
import re
import select
import subprocess
import sys
import termios
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from command import Lidcam
from rosbags.highlevel import AnyReader
from small_scenario import write_small_scenario

from lidcam.pipeline.core.ros.typestores import message_types

PROGRAM = Path(sys.executable).with_name("lidcam")


@dataclass
class Driver:
    """Somebody at a terminal in which `lidcam drive` runs."""

    hand: int
    process: subprocess.Popen[bytes]
    output: Path
    before: list[Any]
    shown: bytes = b""

    def look(self) -> bool:
        """Read what is shown; false once nobody shows anything any more."""
        try:
            self.shown += os.read(self.hand, 4096)
        except OSError:  # the program has closed the terminal
            return False
        return True

    def wait_for(self, text: bytes) -> None:
        """Until the program has shown something."""
        while text not in self.shown:
            assert self.look(), self.shown

    def press(self, key: str) -> None:
        """Press a key, and look on until the simulation has gone on with it."""
        os.write(self.hand, key.encode())
        while select.select([self.hand], [], [], 0)[0]:  # what was shown before the key
            assert self.look(), self.shown
        begin_s = self.now_s()
        while self.now_s() < begin_s + 0.3:
            assert self.look(), self.shown

    def now_s(self) -> float:
        """How far the simulation has gone, as it is shown."""
        return float(re.findall(rb"\r *([\d.]+) s ", self.shown)[-1])

    def leave(self) -> int:
        """The exit code, once it has ended by itself, with the terminal as it was."""
        while self.look():
            pass
        assert b"Traceback" not in self.shown
        assert termios.tcgetattr(self.hand) == self.before
        return self.process.wait()


LIDAR_ALONE: dict[str, Any] = {"cameras": {}}
"""One sensor is measured without another process, which takes three seconds to start."""


@pytest.fixture
def driver(tmp_path: Path) -> Iterator[Driver]:
    scenario = write_small_scenario(tmp_path / "small.yaml", **LIDAR_ALONE)
    hand, terminal = pty.openpty()
    before = termios.tcgetattr(hand)
    command = [str(PROGRAM), "drive", str(scenario), str(tmp_path / "out.bag")]
    process = subprocess.Popen(
        command, stdin=terminal, stdout=terminal, stderr=terminal, cwd=tmp_path, start_new_session=True
    )
    os.close(terminal)
    yield Driver(hand, process, tmp_path / "out.bag", before)
    process.kill()
    process.wait()
    with suppress(OSError):
        os.close(hand)


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


def test_all_keys(driver: Driver) -> None:
    driver.wait_for(b"car1 at")
    for key in "wasdx2w1w":
        driver.press(key)
    os.write(driver.hand, b"o")
    assert driver.leave() == 0
    assert b"wrote" in driver.shown
    forward, left, right = (0.3, 0.0), (0.3, 0.49), (0.3, -0.49)
    assert drives(driver.output, "car1") == [(0, 0), forward, left, (-0.3, 0), right, (0, 0), forward]
    assert drives(driver.output, "car2") == [(0, 0), forward]


def test_scripted_keys_give_the_same_bytes_each_time(lidcam: Lidcam, tmp_path: Path) -> None:
    scenario = write_small_scenario(tmp_path / "small.yaml", **LIDAR_ALONE)
    for name in ("a.mcap", "b.mcap"):
        done = lidcam("drive", scenario, tmp_path / name, "--keys", "wa2w", "--key-interval", 0.3)
        assert done.code == 0, done.err
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    done = lidcam("drive", scenario, tmp_path / "c.bag", "--keys", "wdoww", "--key-interval", 0.3)
    assert done.code == 0, done.err
    assert "0.6 s" in done.err  # nothing after the key to quit
    assert drives(tmp_path / "c.bag", "car1") == [(0.3, 0.0), (0.3, -0.49)]


def test_lidcam_opens_what_it_simulated(lidcam: Lidcam, tmp_path: Path) -> None:
    scenario = write_small_scenario(tmp_path / "small.yaml", lidars__top__output="both", lidars__top__firing_stride=1)
    done = lidcam("simulate", scenario, tmp_path / "out.mcap", "--duration", 0.5)
    assert (done.code, done.out) == (0, ""), done.err
    assert f"wrote {tmp_path / 'out.mcap'}:" in done.err
    done = lidcam("inspect", tmp_path / "out.mcap", "-v")
    assert done.code == 0, done.err
    for topic in ("/points", "/packets", "/image/compressed", "/boxes", "/ground_truth/objects"):
        assert topic in done.out
