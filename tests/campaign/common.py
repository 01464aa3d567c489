"""Numbered cases that can be repeated, counted outcomes, children with limits; imported first, as it sets the path.

Case N of seed S is the same on every machine: a failure is repeated with `--seed S --case N`.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count as count_from
from pathlib import Path
from random import Random
from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]
LIDCAM = (sys.executable, "-P", "-m", "lidcam")
"""The program, for `run_child`, which sees to it that the sources tried are these."""

KEPT = ROOT / "out" / "campaign"
MAX_KEPT = 20
"""Failures of one campaign that are kept; all are counted."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one case went: what it is counted as, and the files to keep of a fault."""

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
        try_case: Tries the case of a number; all chance comes from its generator. What it raises is a fault, too.
        count: Cases without `--count` or `--minutes`.
        arguments: The command line; None: that of the process.
        max_case_s: What takes longer is a hang.

    Returns:
        The exit code: 1 if anything fell short.
    """
    parser = argparse.ArgumentParser(prog=f"tests/campaign/{name}.py")
    parser.add_argument("--count", type=int, help=f"cases (default: {count}, or as many as --minutes allow)")
    parser.add_argument("--minutes", type=float, help="duration")
    parser.add_argument("--seed", type=int, default=1, help="of all chance (default: %(default)s)")
    parser.add_argument("--case", type=int, help="only this one, with its detail")
    parser.add_argument("--out", type=Path, default=KEPT, help="folder of failures (default: out/campaign)")
    options = parser.parse_args(arguments)
    folder = options.out / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    counts, faults = Counter[str](), Counter[str]()
    started_s = time.monotonic()
    end_s = started_s + 60 * (float("inf") if options.minutes is None else options.minutes)
    most = options.count or (count if options.minutes is None else sys.maxsize)
    for number in count_from() if options.case is None else [options.case]:
        if options.case is None and (number >= most or time.monotonic() >= end_s):
            break
        outcome = _tried(try_case, number, options.seed, max_case_s)
        counts[outcome.kind] += 1
        if outcome.is_fault:
            faults[outcome.kind] += 1
            if faults.total() <= MAX_KEPT:
                _keep(folder / f"case{number}", outcome)
        if options.case is not None:
            print(f"case {number}: {outcome.kind}: {outcome.detail}")
    print(f"{name}: seed {options.seed}, {counts.total()} cases, {time.monotonic() - started_s:.0f} s")
    for kind, cases in sorted(counts.items(), key=lambda item: (item[0] not in faults, -item[1], item[0])):
        print(f"  {cases:>9}  {kind}{'  <- falls short' if kind in faults else ''}")
    if faults:
        print(f"  kept in {folder}; repeat one with --seed {options.seed} --case N")
    return int(bool(faults))


def _tried(try_case: Callable[[int, Random], Outcome], number: int, seed: int, max_case_s: float) -> Outcome:
    try:
        with time_limit(max_case_s):
            return try_case(number, Random(f"{seed} {number}"))
    except CaseTimeoutError as err:
        return Outcome("hang", is_fault=True, detail=str(err))
    except Exception as err:
        return Outcome(f"crash: {type(err).__name__}", is_fault=True, detail=traceback.format_exc())


def _keep(folder: Path, outcome: Outcome) -> None:
    folder.mkdir()
    (folder / "outcome.txt").write_text(f"{outcome.kind}\n{outcome.detail}\n", errors="replace")
    for name, data in outcome.files.items():
        (folder / name).write_bytes(data)


@dataclass(frozen=True, slots=True)
class Child:
    """A process that has ended; `returncode` is negative after a signal, `is_hung` after its time limit."""

    returncode: int
    stdout: str
    stderr: str
    seconds: float
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
    env: Mapping[str, str] | None = None,
    during: Callable[[int], None] | None = None,
) -> Child:
    """Run a command to its end, with more variables than those of this process.

    `during` is called with the number of the process once it runs, for instance to send signals. Its output goes to
    files: a pipe would stay open as long as anything that it started.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started_s, is_hung = time.monotonic(), False
        environment = os.environ | {"PYTHONPATH": str(ROOT)} | dict(env or {})
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=err, env=environment, start_new_session=True
        )
        if during is not None:
            during(process.pid)
        try:
            process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            is_hung = True
            process.kill()
        returncode, seconds = process.wait(), time.monotonic() - started_s
        out.seek(0)
        err.seek(0)
        told, errors = (file.read().decode(errors="replace") for file in (out, err))
        return Child(returncode, told, errors, seconds, is_hung)
