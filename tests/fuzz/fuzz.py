"""Fuzz every decoder in turn: `python tests/fuzz/fuzz.py [--minutes M] [NAME ...]`; see `harnesses`.

Prints how many inputs each was tried with. Ends with 1 where one broke its contract, took more memory or time than an
input may, and leaves the input in `out/fuzz/`.
"""

import argparse
import os
import re
import subprocess
import sys
import time
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


class Outcome(NamedTuple):
    """How it went with one decoder."""

    name: str
    inputs: int
    seconds: float
    memory_mib: int
    fault: str


def main() -> int:
    """The number of decoders that broke their contract, at most 1."""
    from harnesses import HARNESSES

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=15.0, help="in all (default: %(default)g)")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(HARNESSES)} (default: all)")
    options = parser.parse_args()
    if unknown := set(options.names) - HARNESSES.keys():
        parser.error(f"no decoder is called {', '.join(sorted(unknown))}")
    names = options.names or [*HARNESSES]
    seconds = max(round(options.minutes * 60 / len(names)), 1)
    print(f"{'decoder':<24}{'inputs':>10}{'seconds':>10}{'MiB':>8}  result", flush=True)
    outcomes = []
    for name in names:
        outcome = fuzz(name, HARNESSES[name].seeds(), seconds)
        outcomes.append(outcome)
        result = outcome.fault or "held"
        print(f"{name:<24}{outcome.inputs:>10}{outcome.seconds:>10.0f}{outcome.memory_mib:>8}  {result}", flush=True)
    total, took = sum(outcome.inputs for outcome in outcomes), sum(outcome.seconds for outcome in outcomes)
    print(f"{'all':<24}{total:>10}{took:>10.0f}{max(outcome.memory_mib for outcome in outcomes):>8}")
    return int(any(outcome.fault for outcome in outcomes))


def fuzz(name: str, seeds: list[bytes], seconds: int) -> Outcome:
    """Fuzz one decoder for some time, from its seeds and what was found before."""
    FOUND.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as scratch:
        folder = Path(scratch) / "seeds"
        folder.mkdir()
        for number, seed in enumerate(seeds):
            (folder / f"seed{number}").write_bytes(seed)
        before = FUZZ / "corpus" / name
        command = [
            sys.executable,
            str(FUZZ / "one.py"),
            name,
            f"-max_total_time={seconds}",
            f"-rss_limit_mb={MAX_MEMORY_MIB}",
            f"-timeout={MAX_SECONDS_PER_INPUT}",
            f"-max_len={MAX_BYTES}",
            "-print_final_stats=1",
            "-seed=1",
            f"-artifact_prefix={FOUND}/{name}-",
            str(folder),
            *([str(before)] if before.is_dir() else []),
        ]
        started = time.monotonic()
        scratch_files = os.environ | {"TMPDIR": scratch}  # libFuzzer ends a process without cleaning up
        ended = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False, cwd=ROOT, env=scratch_files
        )
        took = time.monotonic() - started
    log = ended.stdout + ended.stderr
    (FOUND / f"{name}.log").write_text(log)
    inputs = _last(r"number_of_executed_units: (\d+)", log) or _last(r"^#(\d+)\s", log)
    fault = ""
    if ended.returncode:
        lines = [
            line for line in log.splitlines() if re.match(r"\w*(Error|Exception)\b|ERROR: libFuzzer", line.strip("= "))
        ]
        fault = f"exit {ended.returncode}: {(lines or ['see the log'])[0][:120]} (out/fuzz/{name}.log)"
    return Outcome(name, inputs, took, _last(r"peak_rss_mb: (\d+)", log) or _last(r"rss: (\d+)Mb", log), fault)


def _last(pattern: str, log: str) -> int:
    found = re.findall(pattern, log, re.MULTILINE)
    return int(found[-1]) if found else 0


if __name__ == "__main__":
    sys.exit(main())
