"""A program that is told to end does so from wherever it is: at once, with one line and the exit code of shells."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from signal import SIGHUP, SIGTERM

import pytest

BEGIN = """
import os, signal, sys
from pathlib import Path
from lidcam.signals import end_at_signals
end_at_signals()
from lidcam.pipeline.core.ending import undone_at_once

kept = Path(sys.argv[1])
kept.touch()
me, number = os.getpid(), signal.Signals(int(sys.argv[2]))

def killed():
    os.kill(me, number)
    while True:
        pass
"""

PLACES = {
    "at rest": """
with undone_at_once(kept.unlink):
    killed()
""",
    "in a finaliser": """
class Final:
    def __del__(self):
        killed()

with undone_at_once(kept.unlink):
    Final()
    while True:
        pass
""",
    "while the interpreter ends": """
import atexit
undo = undone_at_once(kept.unlink)
undo.__enter__()

def last():
    killed()

atexit.register(last)
""",
    "while other signals come": """
def undo():
    for other in (number, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(me, other)
    kept.unlink()

with undone_at_once(undo):
    killed()
""",
}
CLOSED = {
    "closed": "os.close(2)",
    "full": """
told, tell = os.pipe()
os.dup2(tell, 2)
os.set_blocking(2, False)
try:
    while True:
        os.write(2, bytes(4096))
except BlockingIOError:
    os.set_blocking(2, True)
""",
}
TOLD = {"SIGINT": "lidcam: interrupted\n", "SIGTERM": "lidcam: terminated\n"}
TOLD["SIGHUP"] = "lidcam: ended: its terminal was closed\n"


def run(code: str, kept: Path, number: signal.Signals, *, dispositions: int = signal.SIG_DFL) -> tuple[int, str, str]:
    """Exit code and output of a program that sends itself a signal."""

    def as_from_a_terminal() -> None:
        for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(one, dispositions)

    done = subprocess.run(
        [sys.executable, "-c", BEGIN + code, str(kept), str(int(number))],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=as_from_a_terminal,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("place", "number"),
    [
        *((place, signal.SIGINT) for place in PLACES),
        *((place, number) for place in ("at rest", "while the interpreter ends") for number in (SIGTERM, SIGHUP)),
    ],
)
def test_wherever_the_program_is(place: str, number: signal.Signals, tmp_path: Path) -> None:
    assert run(PLACES[place], tmp_path / "kept", number) == (128 + number, "", TOLD[number.name])
    assert not (tmp_path / "kept").exists()


def test_what_is_ignored_stays_ignored(tmp_path: Path) -> None:
    """As with SIGHUP of a program that nohup starts, and SIGINT of one in the background."""
    code = "os.kill(me, number); print('done')"
    for number in (signal.SIGINT, signal.SIGHUP):
        assert run(code, tmp_path / "kept", number, dispositions=signal.SIG_IGN) == (0, "done\n", "")


@pytest.mark.parametrize("closed", CLOSED)
def test_nobody_reads_what_it_says(closed: str, tmp_path: Path) -> None:
    assert run(CLOSED[closed] + PLACES["at rest"], tmp_path / "kept", signal.SIGTERM) == (143, "", "")
    assert not (tmp_path / "kept").exists()


def test_on_a_terminal_the_line_takes_the_place_of_a_progress_bar(tmp_path: Path) -> None:
    master, terminal = os.openpty()
    code = BEGIN + PLACES["at rest"]
    command = [sys.executable, "-c", code, str(tmp_path / "kept"), str(int(signal.SIGTERM))]
    done = subprocess.run(command, stderr=terminal, check=False)
    os.close(terminal)
    shown = os.read(master, 1000)
    os.close(master)
    assert done.returncode == 143
    assert shown == b"\r\x1b[K\x1b[?25hlidcam: terminated\r\n"
