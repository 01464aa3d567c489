"""Fuzz every decoder: `python tests/fuzz/fuzz.py [--minutes M] [--seed S] [NAME ...]`; see `harnesses`.

Half of a decoder's time is guided by the branches that inputs take, half goes to fast alterations of what that found:
six times as many in a second. Prints how many inputs each was tried with. Ends with 1 where one broke its contract,
took more memory or time than an input may, and leaves the input in `out/fuzz/`.
"""

import argparse
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

FUZZ = Path(__file__).resolve().parent
ROOT = FUZZ.parent.parent
FOUND = ROOT / "out" / "fuzz"
MEMORY = Path("/dev/shm")
sys.path[:0] = [str(ROOT), str(FUZZ.parent / "support"), str(FUZZ)]

LIMITS = ("-rss_limit_mb=2048", "-timeout=20", f"-max_len={1 << 16}")
"""Memory of a process, seconds and bytes of an input."""

WAYS = ("guided", "fast")
MEASURED = ("lidcam.readers", "lidcam.pipeline", "rosbags", "mcap")
"""Packages whose branches guide."""


def main() -> int:
    """1 if a decoder broke its contract."""
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
    seconds = options.minutes * 60 * options.jobs / len(names) / len(WAYS)
    FOUND.mkdir(parents=True, exist_ok=True)
    are_held = []
    with ThreadPoolExecutor(options.jobs) as pool:
        seeds = map(inputs, names)
        for name, (tried, fault) in zip(
            names, pool.map(partial(fuzz, seconds=seconds, seed=options.seed), names, seeds), strict=True
        ):
            print(f"{name:<24}{tried:>10} inputs  {fault or 'held'}", flush=True)
            are_held.append(not fault)
    return int(not all(are_held))


def fuzz(name: str, seeds: list[bytes], *, seconds: float, seed: int) -> tuple[int, str]:
    """Fuzz one decoder for some seconds in each way; the number of inputs, and what was wrong."""
    with TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as scratch:
        (folder := Path(scratch, "inputs")).mkdir()
        for number, one in enumerate(seeds):
            (folder / f"seed{number}").write_bytes(one)
        options = (f"-max_total_time={max(round(seconds), 1)}", f"-seed={seed}", f"-artifact_prefix={FOUND}/{name}-")
        tried, faults = 0, []
        for way in WAYS:
            command = [sys.executable, __file__, way, name, *LIMITS, *options, "-print_final_stats=1", str(folder)]
            environment = os.environ | {"TMPDIR": scratch}  # libFuzzer ends a process without cleaning up
            ended = subprocess.run(command, capture_output=True, errors="replace", check=False, env=environment)
            (log := FOUND / f"{name}-{way}.log").write_text(text := ended.stdout + ended.stderr)
            counts = re.findall(r"^(?:#|stat::number_of_executed_units: )(\d+)", text, re.MULTILINE)
            tried += int(counts[-1]) if counts else 0
            if ended.returncode:
                said = re.search(r"^[ =]*(\w*(?:Error|Exception)\b|ERROR: libFuzzer).*", text, re.MULTILINE)
                faults.append(f"exit {ended.returncode}: {said[0][:120] if said else 'see the log'} ({log})")
    return tried, "; ".join(faults)


def fuzz_here(way: str, name: str) -> None:
    """Fuzz one decoder in this process, which libFuzzer ends."""
    import atheris

    with atheris.instrument_imports(include=[*MEASURED] if way == "guided" else ["none"]):
        from harnesses import HARNESSES
    run = HARNESSES[name].run
    if way == "fast":  # libFuzzer does not begin without a single branch to measure
        run = atheris.instrument_func(lambda data: HARNESSES[name].run(data) if data else None)
    atheris.Setup([sys.argv[0], *sys.argv[3:]], run)
    atheris.Fuzz()


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in WAYS:
        fuzz_here(*sys.argv[1:3])
    sys.exit(main())
