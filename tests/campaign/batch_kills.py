"""Batches that are killed: `python tests/campaign/batch_kills.py [--minutes M | --count N] [--seed S]`.

Each case starts a batch, of either engine in turn, and sends it SIGKILL at a random time, mostly while jobs are at
work, to the process alone or to its group. Started again, until no job is left to a process that outlived the kill, it
must end with the files of a batch that was not killed, byte for byte, and nothing else; results that were there stay as
they are, and jobs that were at work are named.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random

from common import LIDCAM, Child, Outcome, campaign, run_child  # isort: skip
from builders import write_mcap
from small_drive import small_drive

TIMEOUT_S = 300.0
ENGINES = ("ray", "local")
Kill = Callable[[subprocess.Popen[bytes]], None]
NAMED = "an earlier batch was killed while it ran"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign."""
    return campaign("batch_kills", _try_case, count=20, arguments=arguments, max_case_s=4 * TIMEOUT_S)


def _try_case(number: int, chance: Random) -> Outcome:
    engine = ENGINES[number % len(ENGINES)]
    seconds, work_s, expected = _whole(engine)
    at_work, to_group = chance.random() < 0.75, chance.random() < 0.5
    at_s = chance.uniform(0, work_s if at_work else seconds)
    with tempfile.TemporaryDirectory(prefix="batch-kills-") as base:
        out = Path(base, "out")

        def kill(process: subprocess.Popen[bytes]) -> None:
            def sent() -> None:
                while at_work and process.poll() is None and not [*out.glob(".lidcam-batch/*.json")]:
                    time.sleep(0.02)
                time.sleep(at_s)
                with suppress(ProcessLookupError):
                    (os.killpg if to_group else os.kill)(process.pid, signal.SIGKILL)

            threading.Thread(target=sent, daemon=True).start()

        killed = _run(engine, out, kill)
        states = {path.stem: json.loads(path.read_bytes())["state"] for path in out.glob(".lidcam-batch/*.json")}
        done = {out / f"{name}.mcap" for name, state in states.items() if state == "done"}
        before = {path: path.stat().st_mtime_ns for path in done}
        said, runs = "", 0
        table = [{"state": "busy"}]  # a process that outlived the kill is at work on it
        while any(row["state"] == "busy" for row in table) and runs < 20:
            again, runs = _run(engine, out), runs + 1
            said, table = said + again.stderr, json.loads(again.stdout)["jobs"]
        rows = [row["name"] for row in table]
        detail = f"{engine}, killed after {at_s:.1f} s of {'work' if at_work else 'all'}, its group: {to_group}\n"
        detail += f"{killed.returncode} {states}\n{runs} runs\n{said}\n{_files(out)}"
        remade = [path.name for path, stamp in before.items() if path.stat().st_mtime_ns != stamp]
        begun = [name for name, state in states.items() if state == "begun"]
        untold = [name for name in begun if f"{name}: {NAMED}" not in said]
        if _files(out) != expected or rows != sorted({*rows}) or len(rows) != len(RECORDINGS) or remade or untold:
            return Outcome(f"{engine}: half or other results", is_fault=True, detail=f"{detail}\n{remade} {untold}")
    return Outcome(f"{engine}: {len(begun)} at work, {len(done)} done, {runs} runs", detail=detail)


JOBS = 2
RECORDINGS = ("a", "b", "c", "text")


@cache
def _inputs() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="batch-kills-in-"))
    for name in RECORDINGS[:-1]:
        write_mcap(folder / f"{name}.mcap", small_drive("cdr", frames=8 + ord(name) % 3))
    (folder / "text.bag").write_bytes(b"no recording")
    return folder


@cache
def _whole(engine: str) -> tuple[float, float, dict[str, str]]:
    """How long a batch takes that is not killed, how long its jobs, and its files by one process at a time."""
    with tempfile.TemporaryDirectory(prefix="batch-kills-") as base:
        _run("local", Path(base, "out"), jobs=1)
        timed = _run(engine, Path(base, "timed"))
        work_s = sum(row["wall_s"] for row in json.loads(timed.stdout)["jobs"]) / JOBS
        return timed.seconds, work_s, _files(Path(base, "out"))


def _run(engine: str, out: Path, during: Kill | None = None, jobs: int = JOBS) -> Child:
    command: list[str | Path] = [
        *LIDCAM,
        "batch",
        _inputs(),
        "--out",
        out,
        "--engine",
        engine,
        "--jobs",
        str(jobs),
        "--json",
    ]
    return run_child([*command, "--set", "output.images=false"], timeout_s=TIMEOUT_S, during=during)


def _files(out: Path) -> dict[str, str]:
    """Digests of all files by name, what lidcam keeps for itself aside."""
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        for path in sorted(out.iterdir())
        if path.is_file() and path.name != "_jobs.parquet"
    }


if __name__ == "__main__":
    sys.exit(main())
