"""Small recordings that ask for a lot: memory and time stay bounded, and what is wrong is said in one line.

The recordings are those of `hostile_recordings.py`; each is inspected and processed by the program.
"""

import multiprocessing
import sys
from collections.abc import Sequence
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from common import LIDCAM, Child, Outcome, campaign, run_child  # isort: skip
from hostile_recordings import HOSTILE

COUNT = 4 * len(HOSTILE)

MAX_MIB = 1400
"""What a run may hold: 1 GiB, and what the program takes with all of its libraries."""

MAX_SECONDS = 120.0
ADDRESS_SPACE_KIB = 14 << 20
"""So that a case that falls short does not take the machine with it."""

KEPT_BYTES = 4 << 20
EXIT_CODES = {0: "done", 1: "refused", 3: "done, with losses"}


def try_case(number: int, chance: Random) -> Outcome:
    """Write a hostile recording, then inspect or process it."""
    name = [*HOSTILE][number % len(HOSTILE)]
    with TemporaryDirectory(prefix="bounds-") as scratch:
        folder = Path(scratch)
        inputs = _written(name, chance, folder)
        files = {path.name: path.read_bytes() for path in folder.rglob("*") if path.stat().st_size < KEPT_BYTES}
        for command in (["inspect", *inputs], ["process", *inputs, folder / "out" / "out.mcap"]):
            (folder / "out").mkdir(exist_ok=True)
            limited = ["sh", "-c", 'ulimit -v "$1"; shift; exec "$@"', "sh", str(ADDRESS_SPACE_KIB), *LIDCAM]
            done = run_child([*limited, *map(str, command)], timeout_s=MAX_SECONDS, cwd=folder)
            if fault := _fault(done):
                detail = f"{command[0]}: {done.seconds:.1f} s, {done.peak_mib} MiB\n{done.stderr[-3000:]}"
                return Outcome(f"{name}: {command[0]}: {fault}", True, detail, files)
            last = EXIT_CODES[done.returncode]
    return Outcome(f"{name}: {last}", detail=f"{done.seconds:.1f} s, {done.peak_mib} MiB; {done.stderr[-500:]}")


def _written(name: str, chance: Random, folder: Path) -> list[Path]:
    """The recording, written by a child: what that holds would count as what the program held."""
    context = multiprocessing.get_context("fork")
    paths = context.SimpleQueue()
    child = context.Process(target=lambda: paths.put(HOSTILE[name](chance, folder)))
    child.start()
    child.join()
    if child.exitcode:
        raise RuntimeError(f"{name} cannot be written")
    found: list[Path] = paths.get()
    return found


def _fault(done: Child) -> str:
    """What fell short in a run; empty if nothing did."""
    errors = [line for line in done.stderr.splitlines() if line.startswith("lidcam: error:")]
    faults = {
        f"more than {MAX_SECONDS:g} s": done.is_hung,
        "a traceback": done.has_traceback,
        f"exit code {done.returncode}": done.returncode not in EXIT_CODES,
        f"more than {MAX_MIB} MiB": done.peak_mib > MAX_MIB,
        "not one line": done.returncode == 1 and len(errors) != 1,
    }
    return next((told for told, is_so in faults.items() if is_so), "")


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 1 if anything fell short."""
    return campaign("bounds", try_case, count=COUNT, arguments=arguments, max_case_s=4 * MAX_SECONDS)


if __name__ == "__main__":
    sys.exit(main())
