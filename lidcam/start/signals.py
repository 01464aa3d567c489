"""Ctrl-C, SIGTERM and SIGHUP end a program at once, from wherever it is, with one line and the exit code of shells.

This is the first thing that a program imports and does: later, a signal could come while a library is loading. No
exception is raised, which a library, a finaliser or a thread that waits could lose; what has to go is removed, see
`pipeline.core.ending`.
"""

import _thread
import os
import select
import signal
import sys
import time
from types import FrameType

from pipeline.core.ending import undo_all

__all__ = ["end_at_signals"]

PATIENCE_S = 1.0
"""When the main thread is busy in a library for longer than this, another thread ends the program."""

STDERR = 2
WHY = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "ended: its terminal was closed"}

_begun_s: list[float] = []


def end_at_signals() -> None:
    """From now on, end at each of these signals; one that is ignored, as nohup does with SIGHUP, stays ignored."""
    for number in WHY:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end_now)
    told, tell = os.pipe()
    os.set_blocking(tell, False)
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    _thread.start_new_thread(_watch, (told,))


def _end_now(number: int, _: FrameType | None) -> None:
    """On the main thread, between two instructions of the interpreter."""
    _end(number)


def _watch(told: int) -> None:
    """End the program if the main thread does not come to it; the system tells `told` the signals as they arrive."""
    while True:
        for number in os.read(told, 64):
            if signal.getsignal(number) is _end_now:  # not while driving, nor while files get their names
                time.sleep(PATIENCE_S)
                _end(number)


def _end(number: int) -> None:
    """End with the exit code that shells use; a second signal ends what takes the first one long."""
    if not _begun_s:
        _begun_s.append(time.monotonic())
        try:
            undo_all()
            _say(WHY[signal.Signals(number)])
        finally:
            os._exit(128 + number)
    elif time.monotonic() - _begun_s[0] > PATIENCE_S:
        os._exit(128 + number)


def _say(why: str) -> None:
    """One line on stderr, in place of a progress bar and its hidden cursor; nothing if nobody takes it."""
    if sys.__stderr__ is None:
        return  # closed by the caller: the descriptor may be of any file
    if select.select([], [STDERR], [], 0)[1]:
        start = "\r\x1b[K\x1b[?25h" if os.isatty(STDERR) else ""
        os.write(STDERR, f"{start}lidcam: {why}\n".encode())
