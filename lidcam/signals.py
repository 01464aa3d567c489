"""Ctrl-C, SIGTERM and SIGHUP end a program at once, with one line and the exit code of shells.

No exception is raised, which a library or a finaliser could lose: `lidcam.pipeline.core.ending` removes what has to go.
"""

import os
import select
import signal
import sys
from types import FrameType

from lidcam.pipeline.core.ending import ENDING_SIGNALS, undo_all

STDERR = 2


def end_at_signals() -> None:
    """From now on, end at each of these signals; one that is ignored, as nohup does with SIGHUP, stays ignored."""
    for number in ENDING_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def _end(number: int, _: FrameType | None) -> None:
    """End with the exit code that shells use; further signals do not disturb it."""
    for other in ENDING_SIGNALS:
        signal.signal(other, signal.SIG_IGN)
    try:
        undo_all()
        _say(ENDING_SIGNALS[signal.Signals(number)])
    finally:
        os._exit(128 + number)


def _say(reason: str) -> None:
    """One line on stderr, in place of a progress bar and its hidden cursor; nothing if nobody takes it."""
    if sys.__stderr__ is None:
        return  # closed by the caller: the descriptor may be of any file
    if select.select([], [STDERR], [], 0)[1]:
        start = "\r\x1b[K\x1b[?25h" if os.isatty(STDERR) else ""
        os.write(STDERR, f"{start}lidcam: {reason}\n".encode())
