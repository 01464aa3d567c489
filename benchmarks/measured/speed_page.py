"""How fast lidcam is beside other programs, alternating in one run; writes the tables of docs/performance.md.

    python benchmarks/measured/speed_page.py [--rounds 7] [--model yolox.onnx] [--print] [RECORDING ...]

Without recordings: the sample in `bags/`, as it is and fifty times in a row, which shows what is paid once; and the
seed rig, which is simulated (three lidars of 30 000 points, eight cameras of 640 x 480). Recordings that are given come
in addition; lidcam finds out the settings of those itself, and the straight script takes those of a road. With a model
both look at all images of them. lidcam shows these larger by default than the script, which scales them to fit a square
of 416 x 416; a second row scales them as the script does. It is without the script's padding, which shows nothing and
is two thirds of the square for images of KITTI. The peer is `straight_script.py`, with the same filters and detectors
switched on. A round is one run of each program; rounds follow each other, so that all see the same machine. What else
the machine does can only make a run slower, so the fastest of the rounds says what a program needs, as in `timeit`; the
median beside it says how calm the machine was. With --print the page stays as it is.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from statistics import median
from typing import NamedTuple

import yaml
from pages import LIDCAM, ROOT, repeated, run_lidcam, table, write_part

PAGE = ROOT / "docs" / "performance.md"
SCRIPT = "straight script"
SEED_SECONDS = 30.0
LONGER = 50
MIN_MS = 0.05
SAME_STAGES = ("--set", "combine.outliers.std_ratio=0.2", "--set", "detect3d.method=cluster")  # as the straight script
SCRIPT_PX = 416  # sides of what it gives its network
STRIDE_PX = 32  # of YOLOX, in which sizes are counted

STAGES = {
    "read": (("read",), ()),
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
    ways: dict[str, tuple[str, ...]]  # more options of lidcam by the end of its row's name; each is a row of its own


@dataclass(frozen=True)
class Run:
    """One run of a program: times on the clock, of the processors with the start, and its peak of memory."""

    frames: int
    speed: float  # frames per second
    processor_s: float
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
    command = [sys.executable, str(ROOT / "benchmarks" / "velodyne.py")]
    lines += ["```", subprocess.run(command, check=True, capture_output=True, text=True).stdout.rstrip(), "```"]
    text = "\n".join(lines)
    print(text)
    if not options.prints:
        write_part(PAGE, "measured", text)


def _cases(recordings: Sequence[Path], model: Path | None, folder: Path) -> list[Case]:
    seed, longer, sample = folder / "seed.bag", folder / "longer.bag", ROOT / "bags" / "sandbox.bag"
    run_lidcam("simulate", "sandbox", seed, "--duration", SEED_SECONDS)
    own = {"sample": sample, f"sample, {LONGER} times": repeated(sample, LONGER, longer), "seed rig": seed}
    settings, sandbox = ("--config", "sandbox", *SAME_STAGES), ("--ground", "0.02", "--link", "0.12")
    cases = [Case(name, path, settings, sandbox, {"": ()}) for name, path in own.items()]
    network = (("--model-2d", str(model)), ("--model", str(model))) if model else ((), ())
    for path in recordings:
        ways: dict[str, tuple[str, ...]] = {"": ()}
        if model:
            ways |= _as_the_script_scales(path, folder)
        cases.append(Case(path.stem, path, (*SAME_STAGES, *network[0]), network[1], ways))
    return cases


def _as_the_script_scales(recording: Path, folder: Path) -> dict[str, tuple[str, ...]]:
    """Options that scale images as the script does: by what fits the largest side of all into its square.

    The input is the least that holds all images so scaled. Cameras whose images have other shapes get the same input,
    and it scales them as the square does, as it fits these, too.
    """
    rig = folder / "rig.yaml"
    run_lidcam("inspect", recording, "--write-rig", rig, "--overwrite")
    sizes_px = [(one["width_px"], one["height_px"]) for one in yaml.safe_load(rig.read_text())["cameras"].values()]
    fitted = [tuple(side * SCRIPT_PX / max(size) for side in size) for size in sizes_px]
    width_px, height_px = (ceil(max(sides) / STRIDE_PX) * STRIDE_PX for sides in zip(*fitted, strict=True))
    name = f", the script's scale ({width_px} x {height_px})"
    return {name: ("--set", f"detect2d.input=[{width_px},{height_px}]")}


def _section(case: Case, rounds: int, out: Path) -> list[str]:
    """The tables of one recording."""
    files = [str(case.recording), str(out)]
    programs = {
        f"lidcam{way}, {workers} worker{'s' * (workers > 1)}": [
            *(*LIDCAM, "process", *files, "--json", "--overwrite", "--workers", str(workers)),
            *(*case.lidcam, *options),
        ]
        for way, options in case.ways.items()
        for workers in (1, 2)
    }
    one, two = list(programs)[:2]
    _run([*programs[one], "--duration", "0.5"])  # not counted: functions that it compiles are kept for the next runs
    script = Path(__file__).with_name("straight_script.py")
    programs[SCRIPT] = [sys.executable, str(script), *files, *case.script]
    runs: dict[str, list[Run]] = {name: [] for name in programs}
    for _ in range(rounds):
        for name, command in programs.items():
            runs[name].append(_run(command))
    rows = [
        [
            *(name, f"{_fastest(found).speed:.2f}", f"{median(run.speed for run in found):.2f}"),
            *(f"{times:.2f}" for times in _times(found, runs[SCRIPT])),
            f"{min(run.processor_s / run.frames * 1e3 for run in found):.0f}",
            f"{median(run.peak_mib for run in found):.0f}",
            f"{median(run.load for run in found):.1f}",
        ]
        for name, found in runs.items()
    ]
    head = ["", "frames/s", "median", "times the script", "median", "processor ms a frame, with the start", "peak MiB"]
    lines = [f"### {case.name}: {runs[one][0].frames} frames", "", *table([*head, "load"], rows)]
    times, in_the_median = _times(runs[two], runs[one])
    lines += [f"2 workers against 1: {times:.2f} times, {in_the_median:.2f} in the median of {rounds} rounds.", ""]
    return lines + _stages({name: _fastest(found).stages_ms for name, found in runs.items() if ", 2 w" not in name})


def _fastest(runs: Sequence[Run]) -> Run:
    return max(runs, key=lambda run: run.speed)


def _times(runs: Sequence[Run], others: Sequence[Run]) -> tuple[float, float]:
    """How many times as fast, the fastest of each, and in the median of the rounds."""
    within_rounds = median(a.speed / b.speed for a, b in zip(runs, others, strict=True))
    return _fastest(runs).speed / _fastest(others).speed, within_rounds


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
    load = os.getloadavg()[0]
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=out, stderr=errors, cwd=ROOT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        errors.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}\n{errors.read()}")
        tree = json.loads(out.read())
    timing, processor_s = tree["timing"], usage.ru_utime + usage.ru_stime
    frames, peak_mib = timing.get("frames") or tree["frames"], usage.ru_maxrss / 1024
    return Run(frames, timing["frames_per_second"], processor_s, peak_mib, timing["stage_ms"], load)


if __name__ == "__main__":
    main()
