"""Signals at any time: `python tests/campaign/signals.py [--minutes M | --count N] [--seed S]`.

A command gets SIGINT, SIGTERM or SIGHUP at a random time, alone or with its group, and sometimes a second one soon
after. It must end at once, with exit code 128 + N and one line, and leave no output, no temporary file and no process;
or its outputs are whole. What the interpreter does before and after lidcam's code is counted apart. After SIGKILL each
output is whole or missing, the main one is there only with all others, and the next run cleans up and succeeds.
"""

import hashlib
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random

from common import LIDCAM, Child, Outcome, campaign, run_child  # isort: skip
import zstandard
from builders import write_mcap
from small_drive import small_drive
from small_scenario import write_small_scenario

TIMEOUT_S = 120.0
MAX_END_S = 2.0
"""From the signal to the end."""

MAX_LINE_CHARACTERS = 5000

COMMANDS = (
    "inspect {in}/drive.mcap",
    "process {in}/drive.mcap {out}/out.mcap --rerun {out}/out.rrd",
    "process {in}/drive.mcap.zstd {out}/out.mcap",
    "simulate {in}/small.yaml {out}/out.bag --duration 1 --workers 2",
    "inspect {in}/damaged.mcap --repair {out}/out.mcap",
    "process {in}/drive.mcap {out}/out.mcap --rerun {out}/out.rrd --workers 1",
)
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)


def _try_case(number: int, chance: Random) -> Outcome:
    command = COMMANDS[number % len(COMMANDS)]
    seconds, expected = _whole(command)
    sent = chance.choice(SIGNALS)
    at_s = [chance.uniform(0, seconds)]
    if chance.random() < 0.3:
        at_s.append(at_s[0] + chance.uniform(0, 0.3))
    to_group = chance.random() < 0.3
    with tempfile.TemporaryDirectory(prefix="signals-") as base:
        out, temporary = Path(base, "out"), Path(base, "tmp")
        out.mkdir()
        temporary.mkdir()
        name, pids = command.split(maxsplit=1)[0], list[int]()

        def during(pid: int) -> None:
            pids.append(pid)
            for timer in timers:
                timer.start()

        def send() -> None:
            with suppress(ProcessLookupError):
                (os.killpg if to_group else os.kill)(pids[0], sent)

        timers = [threading.Timer(at, send) for at in at_s]
        child = _run(command, out, temporary, during)
        for timer in timers:
            timer.cancel()
        detail = f"{command}\n{sent.name} at {at_s} s of {seconds:.1f}, to {'its group' if to_group else 'it'}\n"
        if sent == signal.SIGKILL:
            return _killed(command, out, temporary, expected, _processes(pids[0]))
        after, left = _files(out), [*_files(temporary), *_processes(pids[0])]
        detail += f"exit code {child.returncode} after {child.seconds:.2f} s\n{after}\n{left}\n{child.stderr}"
    faults = {"leftovers": left, "hang": child.is_hung, "half outputs or leftovers": after not in ({}, expected)}
    if fault := next((told for told, is_so in faults.items() if is_so), ""):
        return Outcome(f"{name}: {fault}", is_fault=True, detail=detail)
    return _judged(command, sent, child, late_s=child.seconds - at_s[0], is_whole=after == expected, detail=detail)


def _killed(command: str, out: Path, temporary: Path, expected: Mapping[str, str], processes: list[str]) -> Outcome:
    """Of a run that was killed: whole outputs, the main one last; the next run cleans up."""
    name, after = command.split(maxsplit=1)[0], _files(out)
    named = {file: digest for file, digest in after.items() if not file.startswith(".")}
    detail = f"{command}\n{after}\n{processes}\n"
    if processes:
        return Outcome(f"{name}: processes outlive a kill", is_fault=True, detail=detail)
    is_ended = any(file.endswith((".mcap", ".bag")) for file in named)  # the output that gets its name last
    if not named.items() <= expected.items() or (is_ended and named != expected):
        return Outcome(f"{name}: half outputs after a kill", is_fault=True, detail=detail)
    again = _run(command, out, temporary)
    detail += f"exit code {again.returncode} of the next run\n{_files(out)}\n{again.stderr}"
    if again.returncode not in {0, 3} or _files(out) != expected:
        return Outcome(f"{name}: the next run does not clean up", is_fault=True, detail=detail)
    return Outcome(f"{name}: killed, {'whole' if named == expected else 'no'} outputs, and the next run succeeds")


def _judged(command: str, sent: signal.Signals, child: Child, *, late_s: float, is_whole: bool, detail: str) -> Outcome:
    name = command.split(maxsplit=1)[0]
    if child.has_traceback:
        lines = (child.stdout + child.stderr).partition("Traceback")[2]
        if sent == signal.SIGINT and not any(place in lines for place in PLACES):
            return Outcome("apart: while the interpreter started", detail=detail)
        return Outcome(f"{name}: traceback", is_fault=True, detail=detail)
    if child.returncode in {0, 3} and is_whole:
        return Outcome("done before the signal", detail=detail)
    if late_s > MAX_END_S:
        return Outcome(f"{name}: ended {late_s:.0f} s after the signal", is_fault=True, detail=detail)
    if child.returncode == -sent and (is_whole or child.stderr in {"", "lidcam: interrupted\n"}):
        return Outcome("apart: ended by the system's own handling", detail=detail)
    told = child.stderr.splitlines()[-1] if child.stderr else ""
    if child.returncode != 128 + sent or len(told) > MAX_LINE_CHARACTERS or not told.startswith("lidcam: "):
        return Outcome(f"{name}: exit code {child.returncode}: {told[:60]}", is_fault=True, detail=detail)
    left = "its outputs are whole" if is_whole and "{out}" in command else "nothing left"
    return Outcome(f"{name}: one line, {left}", detail=detail)


PLACES = ("lidcam", "pipeline", "readers", "writers", "bags", "numpy", "cv2", "Exception ignored")
"""What a traceback names that comes of our code, or of what that imports."""


def _run(command: str, out: Path, temporary: Path, during: Callable[[int], None] | None = None) -> Child:
    places = {"in": _inputs().name, "out": out}
    arguments = [part.format_map(places) for part in command.split()]
    return run_child([*LIDCAM, *arguments], timeout_s=TIMEOUT_S, env={"TMPDIR": str(temporary)}, during=during)


@cache
def _inputs() -> tempfile.TemporaryDirectory[str]:
    """A folder with a small drive, a damaged and a compressed one, and a scenario; it goes with this process."""
    path = Path((folder := tempfile.TemporaryDirectory(prefix="small_inputs-")).name)
    write_mcap(path / "drive.mcap", small_drive("cdr", frames=30, kinds=("images", "boxes")))
    whole = (path / "drive.mcap").read_bytes()
    (path / "damaged.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    (path / "drive.mcap.zstd").write_bytes(zstandard.compress(whole))
    write_small_scenario(path / "small.yaml")
    return folder


@cache
def _whole(command: str) -> tuple[float, Mapping[str, str]]:
    """Seconds that a command takes, and its outputs."""
    with tempfile.TemporaryDirectory(prefix="signals-") as base:
        (out := Path(base, "out")).mkdir()
        child = _run(command, out, Path(base))
        if child.returncode not in {0, 3}:
            raise RuntimeError(f"{command} does not work: {child.stderr}")
        return child.seconds, _files(out)


def _files(folder: Path) -> dict[str, str]:
    """Digests by name; of Rerun recordings, which hold random numbers, only that they are there."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        if path.is_file() and path.suffix != ".rrd"
        else "there"
        for path in sorted(folder.rglob("*"))
    }


def _processes(session: int) -> list[str]:
    """Processes of a session that do not end: after a kill they see at their next step that their parent is gone."""
    for _ in range(1000):
        found = []
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
                if int(fields[3]) == session and fields[0] != "Z":
                    found.append(f"process {stat.parent.name}")
        if not found:
            break
        time.sleep(0.01)
    return found


if __name__ == "__main__":
    # What runs in the background ignores Ctrl-C, and so would all that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    sys.exit(campaign("signals", _try_case, count=255, max_case_s=3 * TIMEOUT_S))
