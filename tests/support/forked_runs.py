"""Runs of lidcam in forked children: all that a run imports is loaded once, so a run takes half a second.

The parent must not have run anything itself: threads of the libraries do not survive a fork.
"""

import atexit
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

__all__ = ["Ended", "Started", "exit_code", "load", "start", "started_lidcam"]


def load() -> None:
    """Import what runs need."""
    for name in (
        "pandas",  # Rerun imports it in the middle of a run
        "PIL.JpegImagePlugin",
        "rosbags.convert.converter",
        "rosbags.rosbag1",
        "rosbags.rosbag2",
        "bags.simulator.recorder.files",
        "lidcam.__main__",
        "lidcam.commands.inspect",
        "lidcam.commands.process",
        "pipeline.stages.detect3d",
        "scipy.ndimage",
        "scipy.optimize",
        "scipy.spatial.transform",
        "writers.rerun.writer",
    ):
        import_module(name)


@dataclass(frozen=True, slots=True)
class Ended:
    """A run that has ended.

    Attributes:
        code: Its exit code; negative: the signal that ended it at once.
        err: What it printed to stderr.
        is_hung: Whether it was killed because it took too long.
        began_s: When it began (monotonic clock).
        ended_s: When it had ended.
    """

    code: int
    err: str
    is_hung: bool
    began_s: float
    ended_s: float

    @property
    def is_one_line(self) -> bool:
        """Whether it ended with one line about an error."""
        lines = [line for line in self.err.splitlines() if line.startswith("lidcam: error:")]
        return self.code == 1 and len(lines) == 1 and "Traceback" not in self.err


class Started:
    """A run that is under way."""

    def __init__(self, pid: int, err: Path) -> None:
        self.pid, self._err, self._began_s = pid, err, time.monotonic()

    def send(self, number: int, after_s: float) -> None:
        """Send a signal after some time, unless the run has ended by then."""
        until_s = time.monotonic() + after_s
        while (left_s := until_s - time.monotonic()) > 0:
            time.sleep(min(left_s, 0.002))
        os.kill(self.pid, number)  # not waited for yet, so the number is still its own

    def wait(self, timeout_s: float = 30.0) -> Ended:
        """Wait for the end."""
        is_hung = False
        while True:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                break
            if not is_hung and time.monotonic() - self._began_s > timeout_s:
                is_hung = True
                os.kill(self.pid, signal.SIGKILL)
            time.sleep(0.002)
        code = os.waitstatus_to_exitcode(status)
        err = self._err.read_text(errors="replace")
        return Ended(code, err, is_hung, self._began_s, time.monotonic())


def start(work: Callable[[], object], err: Path) -> Started:
    """Do some work in a child; `err` gets what it prints to stderr."""
    err.touch()  # a signal may come before the child does anything
    pid = os.fork()
    if pid:
        return Started(pid, err)
    code = 70
    try:
        os.setsid()
        for number in (signal.SIGALRM, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL if number == signal.SIGALRM else signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, 0)
        null = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1):
            os.dup2(null, descriptor)
        os.dup2(os.open(err, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), 2)
        code = exit_code(work)
        atexit._run_exitfuncs()
        sys.stderr.flush()
    finally:
        os._exit(code)


def started_lidcam(arguments: Sequence[str | Path], err: Path, prepare: Callable[[], object] | None = None) -> Started:
    """Start the program with arguments; `prepare` is called in the child before."""

    def work() -> None:
        from lidcam.__main__ import main

        sys.argv = ["lidcam", *map(str, arguments)]
        if prepare is not None:
            prepare()
        main()

    return start(work, err)


def exit_code(work: Callable[[], object]) -> int:
    """As the interpreter ends."""
    try:
        work()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except KeyboardInterrupt:
        return 130
    except BaseException:
        traceback.print_exc()
        return 1
    return 0
