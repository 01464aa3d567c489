"""A command whose frames several processes share: how it ends, whoever is killed."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from helpers import CLUSTERS

HELD = """
import signal
import sys
import lidcam.processing
import lidcam.pipeline.parallel.run
from lidcam.__main__ import main

write = lidcam.processing._written

def held(*args):
    print("held", file=sys.stderr, flush=True)
    sys.stdin.read()  # until the test lets go
    return write(*args)

lidcam.processing._written = held
lidcam.pipeline.parallel.run.START_S = 0.0
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in what it runs in the background
main()
"""


@pytest.fixture
def run(sandbox: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A run with one more process, in a group of its own, that is held before it writes its first frame.

    It goes on once its standard input is closed: `communicate` does that.
    """
    out = tmp_path / "out.mcap"
    settings = ("--workers", "2", "--set", "track.mode=none", "--set", CLUSTERS)
    arguments = ["process", sandbox, out, "--rerun", out.with_suffix(".rrd"), *settings]
    command = [sys.executable, "-P", "-c", HELD, *map(str, arguments)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stderr=pipe, text=True, start_new_session=True) as process:
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def wait_for(condition: Callable[[], object]) -> None:
    while not condition():
        time.sleep(0.01)


def other_process(run: subprocess.Popen[str]) -> int:
    found: list[int] = []

    def is_there() -> bool:
        assert run.poll() is None
        for pid in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text(encoding="ascii").split():
            with suppress(OSError):  # some library asks a short-lived program for the kind of the processor
                if len([*Path(f"/proc/{pid}/task").iterdir()]) == 3:  # one works, one sends, one receives
                    found.append(int(pid))
        return bool(found)

    wait_for(is_there)
    return found[0]


def is_gone(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return True
    return stat.rpartition(")")[2].split()[0] == "Z"  # nobody has asked for its exit code


def is_at_work(run: subprocess.Popen[str]) -> bool:
    assert run.stderr is not None
    return "held\n" in iter(run.stderr.readline, "")


@pytest.mark.slow
def test_ctrl_c_ends_all_processes_at_once(run: subprocess.Popen[str], tmp_path: Path) -> None:
    assert is_at_work(run)  # the first look had a process of its own
    other = other_process(run)
    os.killpg(run.pid, signal.SIGINT)
    _, told = run.communicate()
    assert told.splitlines()[-1] == "lidcam: interrupted"
    assert "Traceback" not in told
    assert (run.returncode, [*tmp_path.iterdir()]) == (128 + signal.SIGINT, [])
    wait_for(lambda: is_gone(other))
