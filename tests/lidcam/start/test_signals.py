"""A program that is told to end does so from wherever it is: at once, with one line and the exit code of shells."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from common import is_one_line

pytestmark = pytest.mark.traced_processes

BEGIN = """
import os, signal, sys
from pathlib import Path
from lidcam.start.signals import end_at_signals
end_at_signals()
from pipeline.core.ending import undone_at_once

kept = Path(sys.argv[1])
kept.touch()
me, number = os.getpid(), signal.Signals(int(sys.argv[2]))
"""

PLACES = {
    "at rest": """
with undone_at_once(kept.unlink):
    os.kill(me, number)
    while True:
        pass
""",
    "in a finaliser": """
class Final:
    def __del__(self):
        os.kill(me, number)
        while True:
            pass

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
    os.kill(me, number)
    while True:
        pass

atexit.register(last)
""",
    "while another thread ends": """
import threading, time
undo = undone_at_once(kept.unlink)
undo.__enter__()

def other():
    time.sleep(0.1)
    os.kill(me, number)
    time.sleep(60)

threading.Thread(target=other).start()
""",
    "while a module is imported that catches everything": """
Path(kept.with_name("catches.py")).write_text('''
import os
while True:
    try:
        os.kill(os.getpid(), __import__("sys").argv[2] and int(__import__("sys").argv[2]))
    except BaseException:
        pass
''')
sys.path.insert(0, str(kept.parent))
with undone_at_once(kept.unlink):
    import catches
""",
    "in a library that does not return": """
import ctypes, threading
library, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(256)
library.pthread_mutex_lock(mutex)
with undone_at_once(kept.unlink):
    threading.Timer(0.2, os.kill, (me, number)).start()
    library.pthread_mutex_lock(mutex)  # waits for itself, and no signal interrupts it
""",
    "while an error is handled": """
with undone_at_once(kept.unlink):
    try:
        raise ValueError
    finally:
        try:
            os.kill(me, number)
            while True:
                pass
        except BaseException:
            os._exit(3)
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
        timeout=30,
        check=False,
        preexec_fn=as_from_a_terminal,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("place", ["at rest", "while the interpreter ends"])
def test_each_signal(place: str, number: signal.Signals, tmp_path: Path) -> None:
    assert run(PLACES[place], tmp_path / "kept", number) == (128 + number, "", TOLD[number.name])
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("place", PLACES)
def test_wherever_the_program_is(place: str, tmp_path: Path) -> None:
    assert run(PLACES[place], tmp_path / "kept", signal.SIGINT) == (130, "", TOLD["SIGINT"])
    assert not (tmp_path / "kept").exists()


def test_what_is_ignored_stays_ignored(tmp_path: Path) -> None:
    """As with SIGHUP of a program that nohup starts, and SIGINT of one in the background."""
    code = "os.kill(me, number); print('done')"
    for number in (signal.SIGINT, signal.SIGHUP):
        assert run(code, tmp_path / "kept", number, dispositions=signal.SIG_IGN) == (0, "done\n", "")


def test_while_it_is_held_it_waits(tmp_path: Path) -> None:
    """As while files get their names: also for longer than the main thread is waited for."""
    code = """
import time
from writers.outputs.signals import held_signals
with undone_at_once(kept.unlink):
    with held_signals():
        os.kill(me, number)
        time.sleep(1.3)
        print("first", flush=True)
    print("second", flush=True)
"""
    assert run(code, tmp_path / "kept", signal.SIGTERM) == (143, "first\n", TOLD["SIGTERM"])


@pytest.mark.parametrize("signals", [["SIGINT"] * 3, ["SIGTERM", "SIGHUP", "SIGINT"]])
def test_further_signals_do_not_hinder_the_first(signals: list[str], tmp_path: Path) -> None:
    code = f"""
import time

def undo():
    for other in {signals[1:]}:
        os.kill(me, getattr(signal, other))
    time.sleep(0.1)
    kept.unlink()

with undone_at_once(undo):
    os.kill(me, signal.{signals[0]})
    time.sleep(60)
"""
    number = signal.Signals[signals[0]]
    assert run(code, tmp_path / "kept", number) == (128 + number, "", TOLD[number.name])
    assert not (tmp_path / "kept").exists()


def test_a_second_signal_ends_what_takes_long(tmp_path: Path) -> None:
    code = """
import ctypes, threading
library, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(256)
library.pthread_mutex_lock(mutex)

def undo():
    threading.Timer(1.2, os.kill, (me, signal.SIGINT)).start()
    library.pthread_mutex_lock(mutex)

with undone_at_once(undo):
    os.kill(me, signal.SIGINT)
    while True:
        pass
"""
    assert run(code, tmp_path / "kept", signal.SIGINT) == (130, "", "")


@pytest.mark.parametrize("closed", ["os.close(2)", "sys.__stderr__ = None", "fill()"])
def test_nobody_reads_what_it_says(closed: str, tmp_path: Path) -> None:
    code = f"""
def fill():
    told, tell = os.pipe()
    os.dup2(tell, 2)
    os.set_blocking(2, False)
    try:
        while True:
            os.write(2, bytes(4096))
    except BlockingIOError:
        os.set_blocking(2, True)

{closed}
with undone_at_once(kept.unlink):
    os.kill(me, number)
    while True:
        pass
"""
    assert run(code, tmp_path / "kept", signal.SIGTERM) == (143, "", "")
    assert not (tmp_path / "kept").exists()


def test_what_cannot_be_undone_hinders_nothing(tmp_path: Path) -> None:
    code = """
def fail():
    raise OSError

with undone_at_once(kept.unlink), undone_at_once(fail):
    os.kill(me, number)
    while True:
        pass
"""
    assert run(code, tmp_path / "kept", signal.SIGTERM) == (143, "", TOLD["SIGTERM"])
    assert not (tmp_path / "kept").exists()


def test_on_a_terminal_the_line_takes_the_place_of_a_progress_bar(tmp_path: Path) -> None:
    master, terminal = os.openpty()
    code = BEGIN + PLACES["at rest"]
    command = [sys.executable, "-c", code, str(tmp_path / "kept"), str(int(signal.SIGTERM))]
    done = subprocess.run(command, stderr=terminal, timeout=30, check=False)
    os.close(terminal)
    shown = os.read(master, 1000)
    os.close(master)
    assert done.returncode == 143
    assert shown == b"\r\x1b[K\x1b[?25hlidcam: terminated\r\n"


def test_from_the_first_import_on(tmp_path: Path) -> None:
    """Signals come while the program loads its libraries, in steps of 20 ms."""
    for step in range(2, 12):
        with subprocess.Popen(
            [sys.executable, "-m", "lidcam", "inspect", tmp_path / "none.bag"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
        ) as program:
            time.sleep(0.02 * step)
            program.send_signal(signal.SIGINT)
            out, err = program.communicate(timeout=30)
        if "Traceback" in err:
            assert "lidcam" not in err.partition("Traceback")[2], err  # the interpreter itself was not yet up
        else:
            assert (program.returncode, out) in {(130, ""), (-signal.SIGINT, ""), (1, "")}
            # without a line where the interpreter has not yet taken care of signals itself
            assert is_one_line(err) or (program.returncode, err) == (-signal.SIGINT, "")


def test_ctrl_c_while_lidcam_itself_is_loaded() -> None:
    code = """
import sys

class Interrupting:
    def find_spec(self, name, *_):
        if name == "pipeline":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupting())
import lidcam
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "lidcam: interrupted\n")


def test_other_errors_while_it_is_loaded() -> None:
    code = """
import sys

class Failing:
    def find_spec(self, name, *_):
        if name == "pipeline":
            raise ZeroDivisionError("a bug")

sys.meta_path.insert(0, Failing())
import lidcam
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert done.stderr.endswith("ZeroDivisionError: a bug\n")
