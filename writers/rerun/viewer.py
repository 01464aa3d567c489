"""The Rerun viewer, a program of its own, which shows what a recording logs while it goes on."""

import logging
import os
import subprocess
import sys

import rerun as rr

from lidcam.pipeline.core.errors import OutputError

logger = logging.getLogger(__name__)

WAIT_S = 5.0
"""How long the viewer may take nothing before it is looked whether it has ended."""


def check_display(wanted_by: str, instead: str = "") -> None:
    """Raise OutputError if there is no screen to open a window on: who wants one, and what to do without."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        missing = "expected a display for the Rerun viewer, found none (DISPLAY is not set)"
        raise OutputError(f"{wanted_by}: {missing}{instead and f'; {instead}'}")


def viewer_program(*arguments: str) -> tuple[list[str], dict[str, str]]:
    """The command that starts the viewer, and its environment.

    It is the one installed with the library, on PATH or not. By itself it would listen to the whole network; with CI
    set it sends no usage statistics to its maker.
    """
    command = [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", *arguments]
    return command, os.environ | {"CI": "true"}


def start_viewer(recording: rr.RecordingStream, instead: str = "") -> "subprocess.Popen[bytes]":
    """Open the viewer, unless one is open, and send it what a recording logs; it outlives this program."""
    check_display("--view", instead)
    command, environment = viewer_program("--expect-data-soon", "--hide-welcome-screen")
    null = subprocess.DEVNULL
    # In a session of its own: Ctrl-C is for the run.
    viewer = subprocess.Popen(command, env=environment, stdin=null, stdout=null, stderr=null, start_new_session=True)
    recording.connect_grpc()
    return viewer


class RerunViewer:
    """Shows what a recording logs from now on, in place of `RerunStream`; a run goes on when the viewer ends."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording, self._is_open = recording, True
        self._viewer = start_viewer(recording, "leave it out, and open --rerun OUT.rrd where there is one")

    def check(self) -> None:
        """Warn once if the viewer could not be opened; that is no reason to end a run."""
        if self._is_open and self._viewer.poll():
            self._give_up(f"it ended with {self._viewer.returncode}")

    def flush(self) -> None:
        """Wait until the viewer has all that was logged, if it is open."""
        self.check()
        while self._is_open:
            try:
                self._recording.flush(timeout_sec=WAIT_S)
            except RuntimeError as err:
                self.check()
                if self._viewer.poll() == 0:  # closed; or another one was open already, and is now
                    self._give_up(str(err))
            else:
                return

    def finish(self) -> None:
        """Wait until the viewer has everything; it stays open."""
        self.flush()
        self.discard()

    def discard(self) -> None:
        """Leave the viewer to its user."""
        self._recording.disconnect()

    def _give_up(self, reason: str) -> None:
        self._is_open = False
        self._recording.disconnect()
        logger.warning("--view: the Rerun viewer shows no more, and the run goes on: %s", reason)
