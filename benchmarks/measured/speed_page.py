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
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from math import ceil
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
import yaml
from pages import LIDCAM, ROOT, run_lidcam, table, write_part
from repeated import repeated

PAGE = ROOT / "docs" / "performance.md"
SEED_SECONDS = 30.0
LONGER = 50
WORKERS = 1, 2
MIN_MS = 0.05
SAME_STAGES = ("--set", "combine.outliers.std_ratio=0.2", "--set", "detect3d.method=cluster")  # as the straight script
SCRIPT_PX = 416  # sides of what it gives its network
STRIDE_PX = 32  # of YOLOX, in which sizes are counted
WARM_UP = ("--duration", "0.5")
AS_IT_IS = {"": ()}

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


@dataclass(frozen=True)
class Case:
    """One recording and how both programs are told to treat it."""

    name: str  # Its heading
    recording: Path  # The file
    lidcam: tuple[str, ...]  # Options of lidcam
    script: tuple[str, ...]  # Options of the straight script
    # More options of lidcam, of which each is a row of its own, by what the row is called
    ways: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: AS_IT_IS)


@dataclass(frozen=True)
class Run:
    """One run of a program: times on the clock, of the processors with the start, and what it holds."""

    frames: int
    frames_per_second: float
    processor_s: float
    peak_mib: float
    stages_ms: dict[str, float]
    load: float
    written: int


def main() -> None:
    """Measure, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--print", action="store_true", dest="prints")
    options = parser.parse_args()
    lines = [_machine(), ""]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in _cases(options.recordings, options.model, folder):
            lines += [*_section(case, options.rounds, folder), ""]
    packets = subprocess.run(
        [sys.executable, ROOT / "benchmarks/velodyne.py"], check=True, capture_output=True, text=True
    )
    lines += ["```", *packets.stdout.splitlines(), "```", ""]
    text = "\n".join(lines)
    print(text)
    if not options.prints:
        write_part(PAGE, "measured", text)


def _machine() -> str:
    return f"{len(os.sched_getaffinity(0))} cores; one copies memory at {_bandwidth_gib_per_s():.1f} GiB/s."


@cache
def _bandwidth_gib_per_s() -> float:
    with ProcessPoolExecutor(1) as pool:  # what this process has held would count as the memory of those it starts
        return pool.submit(_copying_gib_per_s).result()


def _copying_gib_per_s() -> float:
    """Of one core, bytes read and written."""
    source = np.ones(1 << 25)
    target = np.empty_like(source)
    seconds = []
    for _ in range(5):
        start = perf_counter()
        np.copyto(target, source)
        seconds.append(perf_counter() - start)
    return 2 * source.nbytes / min(seconds) / (1 << 30)


def _cases(recordings: Sequence[Path], model: Path | None, folder: Path) -> list[Case]:
    settings = "--config", "sandbox", *SAME_STAGES
    seed = folder / "seed.bag"
    run_lidcam("simulate", "sandbox", seed, "--duration", SEED_SECONDS)
    sandbox = "--ground", "0.02", "--link", "0.12"
    network = (("--model-2d", str(model)), ("--model", str(model))) if model else ((), ())
    sample = ROOT / "bags" / "sandbox.bag"
    return [
        Case("sample", sample, settings, sandbox),
        Case(f"sample, {LONGER} times", repeated(sample, LONGER, folder / "longer.bag"), settings, sandbox),
        Case("seed rig", seed, settings, sandbox),
        *(
            Case(
                path.stem,
                path,
                (*SAME_STAGES, *network[0]),
                network[1],
                {**AS_IT_IS, **_as_the_script_scales(path, folder)} if model else AS_IT_IS,
            )
            for path in recordings
        ),
    ]


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


def _section(case: Case, rounds: int, folder: Path) -> list[str]:
    """The tables of one recording."""
    runs: dict[tuple[str, int], list[Run]] = {(way, workers): [] for way in case.ways for workers in WORKERS}
    script: list[Run] = []
    _run_lidcam(case, WARM_UP, folder, 1)  # not counted: functions that it compiles are kept for the next runs
    for _ in range(rounds):
        for (way, workers), found in runs.items():
            found.append(_run_lidcam(case, case.ways[way], folder, workers))
        script.append(_run_script(case, folder))
    named = {f"lidcam{way}, {_counted(workers)}": found for (way, workers), found in runs.items()}
    rows = [
        [
            name,
            f"{_fastest(found).frames_per_second:.2f}",
            f"{_middle(found, 'frames_per_second'):.2f}",
            f"{_times(found, script):.2f}",
            f"{_times_within_rounds(found, script):.2f}",
            f"{min(run.processor_s / run.frames * 1e3 for run in found):.0f}",
            f"{_middle(found, 'peak_mib'):.0f}",
            f"{_middle(found, 'load'):.1f}",
        ]
        for name, found in {**named, "straight script": script}.items()
    ]
    speeds = "frames/s", "median", "times the script", "median"
    head = ["", *speeds, "processor ms a frame, with the start", "peak MiB", "load"]
    one, two = (runs["", workers] for workers in WORKERS)
    lines = [f"### {case.name}: {one[0].frames} frames", "", *table(head, rows)]
    gained = f"{_times(two, one):.2f} times, {_times_within_rounds(two, one):.2f} in the median of {rounds} rounds"
    lines += [f"2 workers against 1: {gained}. {_moved(case, one)}", ""]
    columns = {f"lidcam{way}, {_counted(1)}": runs[way, 1] for way in case.ways}
    return lines + _stages(columns, script)


def _counted(workers: int) -> str:
    return f"{workers} worker{'' if workers == 1 else 's'}"


def _fastest(runs: Sequence[Run]) -> Run:
    return max(runs, key=lambda run: run.frames_per_second)


def _times(runs: Sequence[Run], others: Sequence[Run]) -> float:
    """How many times as fast, the fastest of each."""
    return _fastest(runs).frames_per_second / _fastest(others).frames_per_second


def _times_within_rounds(runs: Sequence[Run], others: Sequence[Run]) -> float:
    return median(a.frames_per_second / b.frames_per_second for a, b in zip(runs, others, strict=True))


def _moved(case: Case, runs: Sequence[Run]) -> str:
    """What a frame's bytes would cost if they were only copied."""
    read_mib, written_mib = (
        size / runs[0].frames / (1 << 20) for size in (case.recording.stat().st_size, runs[0].written)
    )
    ms = 2 * (read_mib + written_mib) / 1024 / _bandwidth_gib_per_s() * 1e3
    return f"A frame is {read_mib:.2f} MiB read and {written_mib:.2f} MiB written: {ms:.2f} ms at the speed of memory."


def _stages(lidcam: Mapping[str, Sequence[Run]], script: Sequence[Run]) -> list[str]:
    """Milliseconds of the clock by stage in the fastest run, of one worker and of the script.

    Args:
        lidcam: Runs by what their column is called.
        script: Runs of the script.
    """
    rows = []
    for stage, (theirs, ours) in STAGES.items():
        theirs_ms, ours_ms = _sum(script, theirs), [_sum(runs, ours) for runs in lidcam.values()]
        if any(ours_ms) or theirs_ms:
            rows.append([stage, *(f"{ms:.2f}" if ours else "" for ms in ours_ms), f"{theirs_ms:.2f}", ""])
    shown = {name for _, names in STAGES.values() for name in names}
    for name in next(iter(lidcam.values()))[0].stages_ms:
        ours_ms = [_sum(runs, (name,)) for runs in lidcam.values()]
        if name not in shown and max(ours_ms) >= MIN_MS:
            rows.append([name, *(f"{ms:.2f}" for ms in ours_ms), "", "lidcam alone"])
    return list(table(["stage, ms a frame", *lidcam, "straight script", ""], rows))


def _sum(runs: Sequence[Run], names: Sequence[str]) -> float:
    return sum(_fastest(runs).stages_ms.get(name, 0.0) for name in names)


def _middle(runs: Sequence[Run], name: str) -> float:
    return median(float(getattr(run, name)) for run in runs)


def _run_lidcam(case: Case, way: Sequence[str], folder: Path, workers: int) -> Run:
    out = folder / "lidcam.mcap"
    command = [*LIDCAM, "process", str(case.recording), str(out), "--json", "--workers", str(workers)]
    return _run([*command, "--overwrite", *case.lidcam, *way], out)


def _run_script(case: Case, folder: Path) -> Run:
    out = folder / "script.mcap"
    script = Path(__file__).with_name("straight_script.py")
    return _run([sys.executable, str(script), str(case.recording), str(out), *case.script], out)


def _run(command: list[str], out: Path) -> Run:
    """One run; ends with the command's own message if it fails."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as complained:
        process = subprocess.Popen(command, stdout=said, stderr=complained, cwd=ROOT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        complained.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}\n{complained.read()}")
        tree = json.loads(said.read())
    timing = tree["timing"]
    return Run(
        timing.get("frames") or tree["frames"],
        timing["frames_per_second"],
        usage.ru_utime + usage.ru_stime,
        usage.ru_maxrss / 1024,
        timing["stage_ms"],
        load,
        out.stat().st_size,
    )


if __name__ == "__main__":
    main()
