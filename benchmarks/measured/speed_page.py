"""How fast lidcam is beside other programs, alternating in one run; writes the tables of docs/performance.md.

    python benchmarks/measured/speed_page.py [--rounds 7] [--model yolox.onnx] [--print] [RECORDING ...]

Without recordings: the sample in `bags/`, and the seed rig, which is simulated (three lidars of 30 000 points, eight
cameras of 640 x 480). Recordings that are given come in addition; lidcam finds out the settings of those itself, and
the straight script takes those of a road. With a model both look at all images of them, which lidcam shows it larger
than the script. lidcam runs as it comes, with its 3D network and tracks, and with clusters alone. The peer is
`straight_script.py`, with the filters and detectors of the latter switched on. A round is one run of each program;
rounds follow each other, so that all see the same machine. What else the machine does can only make a run slower, so
the fastest of the rounds says what a program needs, as in `timeit`. With --print the page stays as it is.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from pages import LIDCAM, ROOT, run_lidcam, table, write_part

PAGE = ROOT / "docs" / "performance.md"
SCRIPT = "straight script"
SEED_SECONDS = 20.0
MIN_MS = 0.05
SAME_STAGES = ("--set", "combine.outliers.std_ratio=0.2", "--set", "detect3d.method=cluster")  # as the straight script
WAYS = {"": (), ", clusters alone": SAME_STAGES}
"""Options of lidcam by the end of its row's name; each is a row of its own."""

STAGES = {
    "read": (("read",), ("read",)),
    "decode clouds": (("decode clouds",), ("decode clouds",)),
    "outliers and ground": (("outliers", "ground"), ("combine",)),
    "3D boxes": (("clusters",), ("detect 3D",)),
    "images": (("decode images",), ("decode images", "read 2D boxes")),
    "2D network": (("detect 2D",), ("detect 2D",)),
    "association": (("associate",), ("associate", "associate all")),
    "write": (("write",), ("write mcap",)),
}
"""Stages of the straight script and of lidcam that do the like; lidcam's others have no counterpart."""


class Case(NamedTuple):
    """One recording and how both programs are told to treat it."""

    name: str
    recording: Path
    lidcam: tuple[str, ...]  # options
    script: tuple[str, ...]  # options


@dataclass(frozen=True)
class Run:
    """One run of a program."""

    frames: int
    speed: float  # frames per second, from the first byte read to the last byte written
    whole_s: float  # from the shell to the exit
    processor_s: float  # of all processes, with their start
    peak_mib: float
    stages_ms: dict[str, float]
    load: float


def main() -> None:
    """Measure, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--print", action="store_true", dest="prints")
    options = parser.parse_args()
    lines = [f"{len(os.sched_getaffinity(0))} cores.", ""]
    with tempfile.TemporaryDirectory() as name:
        for case in _cases(options.recordings, options.model, Path(name)):
            lines += _section(case, options.rounds, Path(name) / "out.mcap")
    text = "\n".join(lines)
    print(text)
    if not options.prints:
        write_part(PAGE, "measured", text)


def _cases(recordings: Sequence[Path], model: Path | None, folder: Path) -> list[Case]:
    seed, sample = folder / "seed.bag", ROOT / "bags" / "sandbox.bag"
    run_lidcam("simulate", "sandbox", seed, "--duration", SEED_SECONDS)
    sandbox = ("--ground", "0.02", "--link", "0.12")
    cases = [
        Case(name, path, ("--config", "sandbox"), sandbox) for name, path in (("sample", sample), ("seed rig", seed))
    ]
    network = (("--model-2d", str(model)), ("--model", str(model))) if model else ((), ())
    return cases + [Case(path.stem, path, *network) for path in recordings]


def _section(case: Case, rounds: int, out: Path) -> list[str]:
    files = [str(case.recording), str(out)]
    programs = {
        f"lidcam{way}, {workers} worker{'s' * (workers > 1)}": [
            *(*LIDCAM, "process", *files, "--json", "--overwrite", "--workers", str(workers)),
            *(*case.lidcam, *options),
        ]
        for way, options in WAYS.items()
        for workers in (1, 2)
    }
    one, two = list(programs)[:2]
    script = Path(__file__).with_name("straight_script.py")
    programs[SCRIPT] = [sys.executable, str(script), *files, *case.script]
    runs: dict[str, list[Run]] = {name: [] for name in programs}
    for _ in range(rounds):
        for name, command in programs.items():
            runs[name].append(_run(command))
    rows = [
        [
            *(name, f"{_fastest(found).speed:.1f}", f"{_fastest(found).speed / _fastest(runs[SCRIPT]).speed:.2f}"),
            *(f"{_whole_s(found):.1f}", f"{_whole_s(runs[SCRIPT]) / _whole_s(found):.2f}"),
            f"{min(run.processor_s / run.frames * 1e3 for run in found):.0f}",
            f"{max(run.peak_mib for run in found):.0f}",
            f"{max(run.load for run in found):.1f}",
        ]
        for name, found in runs.items()
    ]
    times = "times the script"
    head = ["", "frames/s", times, "whole process, s", times, "processor ms a frame", "peak MiB", "load"]
    lines = [f"### {case.name}: {runs[one][0].frames} frames", "", *table(head, rows)]
    lines += [f"2 workers against 1: {_fastest(runs[two]).speed / _fastest(runs[one]).speed:.2f} times.", ""]
    return lines + _stages({name: _fastest(found).stages_ms for name, found in runs.items() if ", 2 w" not in name})


def _fastest(runs: Sequence[Run]) -> Run:
    return max(runs, key=lambda run: run.speed)


def _whole_s(runs: Sequence[Run]) -> float:
    return min(run.whole_s for run in runs)


def _stages(by_program: dict[str, dict[str, float]]) -> list[str]:
    """Milliseconds of the clock by stage in the fastest run, of one worker and of the script, which is last."""

    def cells(ours: Sequence[str], theirs: Sequence[str]) -> list[float | None]:
        wanted = {name: theirs if name == SCRIPT else ours for name in by_program}
        return [sum(by_program[name].get(one, 0.0) for one in names) or None for name, names in wanted.items()]

    rows = [(stage, cells(ours, theirs), "") for stage, (theirs, ours) in STAGES.items()]
    shown = {name for _, names in STAGES.values() for name in names}
    others = [name for name in next(iter(by_program.values())) if name not in shown]
    rows += [(name, cells((name,), ()), "lidcam alone") for name in others]
    kept = [row for row in rows if max(ms or 0.0 for ms in row[1]) >= MIN_MS]
    lines = [[stage, *("" if ms is None else f"{ms:.2f}" for ms in found), note] for stage, found, note in kept]
    return list(table(["stage, ms a frame", *by_program, ""], lines))


def _run(command: list[str]) -> Run:
    """One run, whose JSON tells its times; ends with the command's own message if it fails."""
    load, started = os.getloadavg()[0], time.perf_counter()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=out, stderr=errors, cwd=ROOT)
        _, status, usage = os.wait4(process.pid, 0)
        whole_s = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        errors.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}\n{errors.read()}")
        tree = json.loads(out.read())
    timing, processor_s = tree["timing"], usage.ru_utime + usage.ru_stime
    frames, peak_mib = timing.get("frames") or tree["frames"], usage.ru_maxrss / 1024
    return Run(frames, timing["frames_per_second"], whole_s, processor_s, peak_mib, timing["stage_ms"], load)


if __name__ == "__main__":
    main()
