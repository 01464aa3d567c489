"""Batches that are killed or whose folder is damaged: `python tests/campaign/batches.py [--minutes M | --count N]`.

A batch of two recordings is killed (SIGKILL, alone or with its jobs) at a random time; after some of the kills, or of
whole batches, its results or records are damaged. The next batch makes the results that a batch makes that nobody has
disturbed, and one more finds all of them done. Where a result is no longer one of lidcam, it says so. Layouts, which
users may edit, are left out.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random

from common import LIDCAM, Child, Outcome, campaign, run_child  # isort: skip
from small_drive import small_inputs

NAMES = ("a", "day/b")
REFUSED = "exists and was not written by lidcam"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign."""
    return campaign("batches", _try_case, count=100, arguments=arguments, max_case_s=400)


def _batch(out: Path, kill: tuple[float, bool] | None = None) -> Child:
    def during(process: subprocess.Popen[bytes]) -> None:
        def end() -> None:
            with suppress(ProcessLookupError):
                (os.killpg if kill and kill[1] else os.kill)(process.pid, signal.SIGKILL)

        if kill:
            threading.Timer(kill[0], end).start()

    arguments = ("batch", _logs(), "--out", out, "--duration", "0.3", "--workers", "1", "--jobs", "2", "--objects")
    return run_child([*LIDCAM, *map(str, arguments)], timeout_s=120, during=during)


@cache
def _logs() -> Path:
    inputs = small_inputs()
    for name in NAMES:
        path = inputs / "logs" / f"{name}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(inputs / "drive.mcap", path)
    return inputs / "logs"


@cache
def _whole() -> tuple[float, dict[str, bytes]]:
    """Seconds of a batch, and its results."""
    with tempfile.TemporaryDirectory(prefix="batches-") as base:
        child = _batch(Path(base, "out"))
        if child.returncode:
            raise RuntimeError(child.stderr)
        return child.seconds, _results(Path(base, "out"))


def _results(out: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.suffix in {".mcap", ".parquet"} and path.name != "_jobs.parquet"
    }


def _try_case(number: int, chance: Random) -> Outcome:
    seconds, expected = _whole()
    kill = (chance.uniform(0, seconds), chance.random() < 0.5) if number % 2 else None
    with tempfile.TemporaryDirectory(prefix="batches-") as base:
        out = Path(base, "out")
        first = _batch(out, kill)
        what = f"{'killed' if kill and first.returncode else 'whole'}"
        if not kill or chance.random() < 0.5:
            what += f", {_damage(out, chance)}"
        again = _batch(out)
        while "another batch is processing it" in again.stdout + again.stderr:  # jobs outlive a batch that is killed
            again = _batch(out)
        detail = f"{what} {kill}\n{first.stderr}\n{again.stdout}\n{again.stderr}\n{sorted(_results(out))}"
        if again.is_hung or again.has_traceback:
            return Outcome(f"{what}: hang or traceback", is_fault=True, detail=detail)
        if again.returncode:
            return Outcome(f"{what}: told in a line", is_fault=REFUSED not in again.stderr, detail=detail)
        if _results(out) != expected:
            return Outcome(f"{what}: other results", is_fault=True, detail=detail)
        before = {name: (out / name).stat().st_mtime_ns for name in expected}
        last = _batch(out)
        if last.returncode or before != {name: (out / name).stat().st_mtime_ns for name in expected}:
            return Outcome(f"{what}: done twice", is_fault=True, detail=f"{detail}\n{last.stderr}")
        return Outcome(f"{what}: made whole", detail=detail)


def _damage(out: Path, chance: Random) -> str:
    """Damage a result or a record, if there is one; how."""
    records = (path for path in (out / ".lidcam-batch").rglob("*.json") if path.is_file())
    paths = sorted(path for path in (*records, *(out / name for name in _results(out))) if path.stat().st_size)
    if not paths:
        return "nothing to damage"
    path, how = chance.choice(paths), chance.choice(("cut", "flipped", "zeros", "removed", "another"))
    content = bytearray(path.read_bytes())
    place = chance.randrange(len(content))
    if how == "flipped":
        content[place] ^= 1 << chance.randrange(8)
    elif how == "zeros":
        content[place : place + 4096] = bytes(min(4096, len(content) - place))
    elif how == "another":
        content = bytearray(chance.choice(paths).read_bytes())
    path.write_bytes(content[:place] if how == "cut" else content)
    if how == "removed":
        path.unlink()
    return f"{'record' if path.suffix == '.json' else 'result'} {how}"


if __name__ == "__main__":
    sys.exit(main())
