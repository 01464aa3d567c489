"""Fuzz every decoder: `python tests/fuzz/fuzz.py [--minutes M] [--seed S] [NAME ...]`; see `harnesses`.

Half of a decoder's time is guided by the branches that inputs take, half goes to fast alterations of what that found.
Prints how many inputs each was tried with. Ends with 1 where one broke its contract, took more memory or time than an
input may, and leaves the input in `out/fuzz/`.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

FUZZ = Path(__file__).resolve().parent
ROOT = FUZZ.parent.parent
FOUND = ROOT / "out" / "fuzz"
MEMORY = Path("/dev/shm")
sys.path[:0] = [str(ROOT), str(FUZZ.parent / "support"), str(FUZZ)]

MAX_MEMORY_MIB = 2048
MAX_SECONDS_PER_INPUT = 20
MAX_BYTES = 1 << 16

WAYS = ("guided", "fast")


class Outcome(NamedTuple):
    """How it went with one decoder."""

    name: str
    inputs: int
    seconds: float
    memory_mib: int
    fault: str


def main() -> int:
    """The number of decoders that broke their contract, at most 1."""
    from harnesses import HARNESSES, inputs

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=15.0, help="in all (default: %(default)g)")
    parser.add_argument("--seed", type=int, default=1, help="of all chance (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at once (default: one a core)")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(HARNESSES)} (default: all)")
    options = parser.parse_args()
    if unknown := set(options.names) - HARNESSES.keys():
        parser.error(f"no decoder is called {', '.join(sorted(unknown))}")
    names = options.names or [*HARNESSES]
    seconds = options.minutes * 60 * options.jobs / len(names)
    print(f"{'decoder':<24}{'inputs':>10}{'seconds':>10}{'inputs/s':>10}{'MiB':>8}  result", flush=True)
    outcomes = []
    with ThreadPoolExecutor(options.jobs) as pool:
        running = [pool.submit(fuzz, name, inputs(name), seconds, options.seed) for name in names]
        for ended in running:
            outcomes.append(ended.result())
            _print(outcomes[-1])
    total, took = sum(outcome.inputs for outcome in outcomes), sum(outcome.seconds for outcome in outcomes)
    _print(Outcome("all", total, took, max(outcome.memory_mib for outcome in outcomes), ""))
    return int(any(outcome.fault for outcome in outcomes))


def fuzz(name: str, seeds: Iterable[bytes], seconds: float, seed: int) -> Outcome:
    """Fuzz one decoder for some time, from its seeds and what was found before."""
    FOUND.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as scratch:
        folder = Path(scratch) / "inputs"
        folder.mkdir()
        for number, one in enumerate(seeds):
            (folder / f"seed{number}").write_bytes(one)
        outcomes = [_run(way, name, folder, seconds / len(WAYS), seed) for way in WAYS]
    return Outcome(
        name,
        sum(outcome.inputs for outcome in outcomes),
        sum(outcome.seconds for outcome in outcomes),
        max(outcome.memory_mib for outcome in outcomes),
        next((outcome.fault for outcome in outcomes if outcome.fault), ""),
    )


def _run(way: str, name: str, folder: Path, seconds: float, seed: int) -> Outcome:
    """One process of libFuzzer, which adds to the inputs in the folder."""
    command = [
        sys.executable,
        str(FUZZ / "one.py"),
        way,
        name,
        f"-max_total_time={max(round(seconds), 1)}",
        f"-rss_limit_mb={MAX_MEMORY_MIB}",
        f"-timeout={MAX_SECONDS_PER_INPUT}",
        f"-max_len={MAX_BYTES}",
        "-print_final_stats=1",
        f"-seed={seed}",
        f"-artifact_prefix={FOUND}/{name}-",
        str(folder),
    ]
    started = time.monotonic()
    scratch_files = os.environ | {"TMPDIR": str(folder.parent)}  # libFuzzer ends a process without cleaning up
    ended = subprocess.run(
        command, capture_output=True, text=True, errors="replace", check=False, cwd=ROOT, env=scratch_files
    )
    took = time.monotonic() - started
    log = ended.stdout + ended.stderr
    (FOUND / f"{name}-{way}.log").write_text(log)
    inputs = _last(r"number_of_executed_units: (\d+)", log) or _last(r"^#(\d+)\s", log)
    fault = ""
    if ended.returncode:
        lines = [
            line for line in log.splitlines() if re.match(r"\w*(Error|Exception)\b|ERROR: libFuzzer", line.strip("= "))
        ]
        fault = f"exit {ended.returncode}: {(lines or ['see the log'])[0][:120]} (out/fuzz/{name}-{way}.log)"
    return Outcome(name, inputs, took, _last(r"peak_rss_mb: (\d+)", log) or _last(r"rss: (\d+)Mb", log), fault)


def _print(outcome: Outcome) -> None:
    name, inputs, seconds, memory_mib, fault = outcome
    rate = inputs / max(seconds, 1)
    print(f"{name:<24}{inputs:>10}{seconds:>10.0f}{rate:>10.0f}{memory_mib:>8}  {fault or 'held'}", flush=True)


def _last(pattern: str, log: str) -> int:
    found = re.findall(pattern, log, re.MULTILINE)
    return int(found[-1]) if found else 0


if __name__ == "__main__":
    sys.exit(main())
