"""Recorders of SQLite that are killed, and journals that are damaged: `python tests/campaign/journals.py`.

A writer in one of SQLite's journal modes is killed at a random time; then, mostly, its journals are cut, altered, taken
away or exchanged for those of another database. What lidcam reads has to be what SQLite itself recovers in a copy, or
the difference told, and no file of the folder may change.
"""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from common import Outcome, campaign, run_child  # isort: skip  (puts the tests' folders on the path)

from sound_recordings import Seen, read_all, sound_recording, write_files

from pipeline.core.errors import LidcamError

__all__ = ["main"]

MODES = ("DELETE", "TRUNCATE", "PERSIST", "WAL")

WRITER = """
import sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
database.execute(f"PRAGMA journal_mode={sys.argv[2]}").fetchall()
database.execute("PRAGMA synchronous=OFF")
database.execute("PRAGMA cache_size=4")
rows = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id").fetchall()
last = rows[-1][1]
print("ready", flush=True)
number = 0
while number < 100_000:
    database.execute("BEGIN")
    for topic_id, _, data in rows[: 1 + number % 30]:
        number += 1
        database.execute(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", (topic_id, last + number, data)
        )
    database.execute("COMMIT")
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; the exit code."""
    return campaign("journals", _try_case, count=400, arguments=arguments, max_case_s=60.0)


def _try_case(number: int, chance: Random) -> Outcome:
    with TemporaryDirectory(prefix="lidcam-campaign-") as name:
        root = Path(name)
        mode = MODES[number % len(MODES)]
        folder = _killed(root / "first", mode, chance)
        how = _altered(folder, root, mode, chance)
        expected, refusal = _by_sqlite(folder, root / "copy")
        before = _state(folder)
        outcome = _judged(folder / "rec.db3", expected, refusal)
        detail = f"{mode}, {how}: {outcome.detail}"
        if _state(folder) != before:
            return Outcome("THE INPUT WAS TOUCHED", is_fault=True, detail=detail)
        files = {file.name: file.read_bytes() for file in folder.iterdir()} if outcome.is_fault else {}
        return Outcome(outcome.kind, outcome.is_fault, detail, files)


def _killed(folder: Path, mode: str, chance: Random) -> Path:
    """A folder with what a writer left that was killed."""
    folder.mkdir()
    sound = sound_recording("sqlite")
    path = write_files(folder, sound, sound.files)
    wait_s = chance.uniform(0.1, 0.25)

    def kill(process: subprocess.Popen[bytes]) -> None:
        time.sleep(wait_s)
        os.kill(process.pid, signal.SIGKILL)  # it may have ended, but nobody has waited for it

    run_child([sys.executable, "-c", WRITER, path, mode], during=kill)
    return folder


def _altered(folder: Path, root: Path, mode: str, chance: Random) -> str:
    """Alter the journals that were left; returns how."""
    shm = folder / "rec.db3-shm"
    shm.unlink(missing_ok=True)
    journals = sorted(file for file in folder.iterdir() if file.name != "rec.db3")
    how = chance.choice(("left as it is", "cut", "a bit", "zeros", "taken away", "of another"))
    if not journals:
        return "no journal"
    journal = journals[0]
    content = bytearray(journal.read_bytes())
    at = chance.randrange(max(len(content), 1))
    if how == "cut":
        journal.write_bytes(content[:at])
    elif how == "a bit" and content:
        content[at] ^= 1 << chance.randrange(8)
        journal.write_bytes(content)
    elif how == "zeros":
        content[at : at + 512] = bytes(len(content[at : at + 512]))
        journal.write_bytes(content)
    elif how == "taken away":
        journal.unlink()
    elif how == "of another":
        other = _killed(root / "second", mode, chance) / journal.name
        if other.is_file():
            shutil.copyfile(other, journal)
    return f"{how} at {at} of {len(content)} bytes"


def _by_sqlite(folder: Path, copy: Path) -> tuple[list[tuple[int, bytes]], str]:
    """Log times and bytes of the messages that SQLite recovers, and why it does not."""
    shutil.copytree(folder, copy)
    try:
        with closing(sqlite3.connect(copy / "rec.db3")) as database:
            return database.execute(
                "SELECT timestamp, data FROM messages NOT INDEXED ORDER BY timestamp, id"
            ).fetchall(), ""
    except sqlite3.Error as err:
        return [], str(err)


def _judged(path: Path, expected: list[tuple[int, bytes]], refusal: str) -> Outcome:
    try:
        messages, losses = read_all(path, "as_needed")
    except LidcamError as err:
        if "\n" in str(err):
            return Outcome("an error of more than one line", is_fault=True, detail=str(err))
        kind = "both refuse it" if refusal else "refused, though SQLite reads it"
        return Outcome(kind, is_fault=not refusal, detail=str(err))
    told = "; ".join(f"{loss.reason} ({loss.messages})" for loss in losses)
    if refusal:
        return Outcome("read in part, SQLite refuses it", is_fault=not losses, detail=f"{refusal}; {told}")
    if _content(messages) == expected:
        return Outcome("as SQLite" + (", told" if losses else ""), detail=told)
    detail = f"{len(messages)} messages, SQLite {len(expected)}; {told}"
    if losses and not Counter(expected) - Counter(_content(messages)):
        return Outcome("more than SQLite, told", detail=detail)
    is_told = any(loss.messages != 0 for loss in losses)
    return Outcome("other than SQLite, told" if is_told else "SILENT: other than SQLite", not is_told, detail)


def _content(messages: Sequence[Seen]) -> list[tuple[int, bytes]]:
    return [(message.log_time_ns, message.data) for message in messages]


def _state(folder: Path) -> list[tuple[str, int, int, bytes]]:
    """What of the folder must not change: names, sizes, times of change, content."""
    files = sorted(folder.iterdir())
    return [(file.name, file.stat().st_size, file.stat().st_mtime_ns, file.read_bytes()) for file in files]


if __name__ == "__main__":
    sys.exit(main())
