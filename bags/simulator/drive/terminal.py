"""Keys from a terminal as they are pressed, without Enter or echo; the terminal is always restored."""

import contextlib
import os
import select
import signal
import termios
import time
import tty
from collections.abc import Iterator
from functools import partial
from types import FrameType
from typing import Any

from lidcam.bags.simulator.drive.driving import Pressed
from lidcam.pipeline.core.ending import undone_at_once

ASK_NS = 50_000_000
"""Keys are read at least this often in simulated time."""

ENDINGS = (signal.SIGINT, signal.SIGHUP)
"""Ctrl-C and a closed terminal: both end the drive and keep the recording."""


class TerminalKeys:
    """Keys of an open terminal; see `lidcam.bags.simulator.drive.driving.Keyboard`.

    Simulated time never runs ahead of real time.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._begin = time.monotonic()
        self._keys = ""
        self._ended = False

    def end(self) -> None:
        """End the input."""
        self._ended = True

    def pressed(self, now_ns: int) -> Pressed:
        """See `lidcam.bags.simulator.drive.driving.Keyboard`."""
        del now_ns
        self._read(0.0)
        keys, self._keys = self._keys, ""
        return Pressed(keys, self._ended)

    def next_ns(self, now_ns: int) -> int:
        """See `lidcam.bags.simulator.drive.driving.Keyboard`."""
        return now_ns + ASK_NS

    def wait(self, until_ns: int) -> None:
        """See `lidcam.bags.simulator.drive.driving.Keyboard`; returns early at the end of input, not at a key."""
        while not self._ended and (left_s := self._begin + until_ns * 1e-9 - time.monotonic()) > 0:
            self._read(left_s)

    def _read(self, seconds: float) -> None:
        """Read the keys that are pending, or that come within a time."""
        try:
            ready, _, _ = select.select([self._descriptor], [], [], seconds)
            if not ready:
                return
            data = os.read(self._descriptor, 1024)
        except OSError:  # the terminal is gone
            data = b""
        self._keys += data.decode("ascii", errors="ignore")
        self._ended = self._ended or not data or b"\x04" in data  # in this mode Ctrl-D is a byte


@contextlib.contextmanager
def terminal_keys(descriptor: int) -> Iterator[TerminalKeys]:
    """The keys of a terminal; Ctrl-C and a closed terminal end its input, even when signalled repeatedly."""
    keys = TerminalKeys(descriptor)
    before = termios.tcgetattr(descriptor)
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in ENDINGS}

    def end(_: int, __: FrameType | None) -> None:
        keys.end()

    restore_now = partial(termios.tcsetattr, descriptor, termios.TCSANOW, before)
    try:
        for number in ENDINGS:
            signal.signal(number, end)
        with undone_at_once(restore_now):
            tty.setcbreak(descriptor)
            yield keys
    finally:
        with contextlib.suppress(OSError, termios.error):  # the terminal may be gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        for ending, handler in handlers.items():
            signal.signal(ending, handler)
