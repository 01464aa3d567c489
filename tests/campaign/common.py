"""What the campaigns share: numbered cases that can be repeated, counted outcomes, children with limits.

A campaign is a module beside this one, run as `python tests/campaign/NAME.py`. Its `main(arguments)` calls `campaign`
with a function that tries one case and says how it went.

Case N of seed S is the same on every machine, so that a failure is repeated with `--seed S --case N`. Importing this
module puts the sources and `tests/support` on the path, so it is imported first.
"""

import argparse
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
SEARCHED = [os.environ.get("CAMPAIGN_ROOT", str(ROOT)), str(ROOT / "tests" / "support"), str(ROOT / "tests" / "fuzz")]
"""`CAMPAIGN_ROOT` names another tree of lidcam to try, for instance an older one."""

sys.path[:0] = [path for path in SEARCHED if path not in sys.path]
LIDCAM = (sys.executable, "-P", "-m", "lidcam")
"""The program, for `run_child`, which sees to it that the sources tried are these."""

KEPT = ROOT / "out" / "campaign"
"""Where failures and results go."""

MAX_KEPT = 20
"""Failures of one campaign that are kept; all are counted."""

MAX_LINE_CHARACTERS = 5000


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one case went.

    Attributes:
        kind: What it is counted as.
        is_fault: Whether it falls short of what is promised.
        detail: What was seen, for whoever repeats the case.
        files: What to keep of a fault, by file name.
    """

    kind: str
    is_fault: bool = False
    detail: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)


class CaseTimeoutError(BaseException):
    """A case took longer than it may; not an Exception, so that nothing under test catches it."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise `CaseTimeoutError` in the block after some time (main thread only)."""

    def raise_it(_: int, __: FrameType | None) -> None:
        raise CaseTimeoutError(f"took more than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, raise_it)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def campaign(
    name: str,
    try_case: Callable[[int, Random], Outcome],
    *,
    count: int,
    arguments: Sequence[str] | None = None,
    max_case_s: float = 60.0,
) -> int:
    """Try cases, print the counts, keep what fell short.

    Args:
        name: Of the campaign.
        try_case: Tries the case of a number; all chance comes from the generator that it is given. What it raises is
            a fault, too.
        count: Cases without `--count` or `--minutes`.
        arguments: The command line; None: that of the process.
        max_case_s: What takes longer is a hang.

    Returns:
        The exit code: 1 if anything fell short.
    """
    parser = argparse.ArgumentParser(prog=f"tests/campaign/{name}.py")
    parser.add_argument("--count", type=int, help=f"cases (default: {count}, or as many as --minutes allow)")
    parser.add_argument("--minutes", type=float, help="how long")
    parser.add_argument("--seed", type=int, default=1, help="of all chance (default: %(default)s)")
    parser.add_argument("--case", type=int, help="only this one, with its detail")
    parser.add_argument(
        "--out", type=Path, default=KEPT, help="where failures and the result go (default: out/campaign)"
    )
    options = parser.parse_args(arguments)
    folder = options.out / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    counts: Counter[str] = Counter()
    faults: Counter[str] = Counter()
    started = time.monotonic()
    for number in _numbers(options.case, options.count, options.minutes, default=count):
        outcome = _tried(try_case, number, options.seed, max_case_s)
        counts[outcome.kind] += 1
        if outcome.is_fault:
            faults[outcome.kind] += 1
            if faults.total() <= MAX_KEPT:
                _keep(folder / f"case{number}", outcome)
        if options.case is not None:
            print(f"case {number}: {outcome.kind}: {outcome.detail}")
    seconds = time.monotonic() - started
    peak_mib = (
        max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) // 1024
    )
    print(f"{name}: seed {options.seed}, {counts.total()} cases, {seconds:.0f} s, at most {peak_mib} MiB")
    for kind, cases in sorted(counts.items(), key=lambda item: (item[0] not in faults, -item[1], item[0])):
        print(f"  {cases:>9}  {kind}{'  <- falls short' if kind in faults else ''}")
    if faults:
        print(f"  kept in {folder}; repeat one with --seed {options.seed} --case N")
    record = {
        "seed": options.seed,
        "seconds": round(seconds),
        "peak_mib": peak_mib,
        "counts": dict(sorted(counts.items())),
    }
    (folder / "result.json").write_text(json.dumps(record | {"faults": dict(sorted(faults.items()))}, indent=2) + "\n")
    return int(bool(faults))


def _numbers(case: int | None, count: int | None, minutes: float | None, *, default: int) -> Iterator[int]:
    if case is not None:
        yield case
        return
    end_s = time.monotonic() + 60 * minutes if minutes is not None else float("inf")
    number = 0
    most = count if count is not None else default if minutes is None else sys.maxsize
    while number < most and time.monotonic() < end_s:
        yield number
        number += 1


def _tried(try_case: Callable[[int, Random], Outcome], number: int, seed: int, max_case_s: float) -> Outcome:
    try:
        with time_limit(max_case_s):
            return try_case(number, Random(f"{seed} {number}"))
    except CaseTimeoutError as err:
        return Outcome("hang", is_fault=True, detail=str(err))
    except Exception as err:
        kind = f"crash: {type(err).__name__}"
        return Outcome(kind, is_fault=True, detail=traceback.format_exc())


def _keep(folder: Path, outcome: Outcome) -> None:
    folder.mkdir()
    (folder / "outcome.txt").write_text(f"{outcome.kind}\n{outcome.detail}\n", errors="replace")
    for name, data in outcome.files.items():
        (folder / name).write_bytes(data)


@dataclass(frozen=True, slots=True)
class Child:
    """A process that has ended.

    Attributes:
        returncode: Its exit code; negative: the signal that killed it.
        stdout: What it printed.
        stderr: What it printed there.
        seconds: How long it ran.
        peak_mib: The most memory that it held.
        is_hung: Whether it was killed because it took too long.
    """

    returncode: int
    stdout: str
    stderr: str
    seconds: float
    peak_mib: int
    is_hung: bool

    @property
    def has_traceback(self) -> bool:
        """Whether it ended in, or spoke of, an error that nobody caught."""
        spoken = self.stdout + self.stderr
        return "Traceback (most recent call last)" in spoken or "Exception ignored in" in spoken


def run_child(
    command: Sequence[str | Path],
    *,
    timeout_s: float = 60.0,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    during: Callable[[subprocess.Popen[bytes]], None] | None = None,
) -> Child:
    """Run a command to its end.

    Args:
        command: Program and arguments; `LIDCAM` is lidcam's.
        timeout_s: When it is killed.
        cwd: Its folder.
        env: Its variables, on top of those of this process.
        during: Called once it runs, for instance to send signals, by `os.kill`: the methods of Popen wait for a
            process that has ended, which is done here.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started = time.monotonic()
        process = subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            cwd=cwd,
            env=os.environ | {"PYTHONPATH": SEARCHED[0]} | dict(env or {}),
            start_new_session=True,
        )
        if during is not None:
            during(process)
        hung = threading.Event()

        def end() -> None:
            hung.set()
            os.kill(process.pid, signal.SIGKILL)

        timer = threading.Timer(timeout_s, end)
        timer.daemon = True
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        seconds = time.monotonic() - started
        process.returncode = os.waitstatus_to_exitcode(status)  # Popen must not wait for it again
        out.seek(0)
        err.seek(0)
        return Child(
            process.returncode,
            out.read().decode(errors="replace"),
            err.read().decode(errors="replace"),
            seconds,
            usage.ru_maxrss // 1024,
            hung.is_set(),
        )


def is_one_line(text: str) -> bool:
    """Whether an error is said in one line that a person can read."""
    lines = text.strip("\n").split("\n")
    return len(lines) == 1 and 0 < len(lines[0]) <= MAX_LINE_CHARACTERS
