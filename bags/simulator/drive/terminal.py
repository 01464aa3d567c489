"""Keys from a terminal as they are pressed, without Enter and echo; the terminal is restored whatever happens."""

import contextlib
import os
import select
import signal
import termios
import time
import tty
from collections.abc import Iterator
from types import FrameType
from typing import Any

from bags.simulator.drive.keyboard import Pressed

__all__ = ["TerminalKeys", "terminal_keys"]

ASK_NS = 50_000_000
"""Keys are asked for this often in simulated time, at least."""

ENDINGS = (signal.SIGINT, signal.SIGHUP)
"""Ctrl-C, and a terminal that was closed: both end the drive and keep its recording."""


class TerminalKeys:
    """Keys of an open terminal; see `bags.simulator.drive.keyboard.Keyboard`.

    Simulated time never runs ahead of real time.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._begin = time.monotonic()
        self._keys = ""
        self._ended = False

    def end(self) -> None:
        """No more keys will be read."""
        self._ended = True

    def pressed(self, now_ns: int) -> Pressed:
        """See `bags.simulator.drive.keyboard.Keyboard`."""
        del now_ns
        self._read(0.0)
        keys, self._keys = self._keys, ""
        return Pressed(keys, self._ended)

    def next_ns(self, now_ns: int) -> int:
        """See `bags.simulator.drive.keyboard.Keyboard`."""
        return now_ns + ASK_NS

    def wait(self, until_ns: int) -> None:
        """See `bags.simulator.drive.keyboard.Keyboard`; a key does not end it, the end of the input does."""
        while not self._ended and (left_s := self._begin + until_ns * 1e-9 - time.monotonic()) > 0:
            self._read(left_s)

    def _read(self, seconds: float) -> None:
        """Read what is there, or what comes within a time."""
        try:
            ready, _, _ = select.select([self._descriptor], [], [], seconds)
            if not ready:
                return
            data = os.read(self._descriptor, 1024)
        except OSError:  # the terminal is gone
            data = b""
        self._keys += data.decode("ascii", errors="ignore")
        self._ended = self._ended or not data or b"\x04" in data  # Ctrl-D is a byte here: lines are not put together


@contextlib.contextmanager
def terminal_keys(descriptor: int) -> Iterator[TerminalKeys]:
    """Keys of a terminal; Ctrl-C and a closed terminal are the end of its input, however often they are told."""
    keys = TerminalKeys(descriptor)
    before = termios.tcgetattr(descriptor)
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in ENDINGS}

    def end(_: int, __: FrameType | None) -> None:
        keys.end()

    try:
        for number in ENDINGS:
            signal.signal(number, end)
        tty.setcbreak(descriptor)
        yield keys
    finally:
        with contextlib.suppress(OSError, termios.error):  # a terminal that is gone needs no restoring
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        for ending, handler in handlers.items():
            signal.signal(ending, handler)
