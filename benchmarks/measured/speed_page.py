"""How fast lidcam is beside other programs, alternating in one run; writes the tables of docs/performance.md.

    python benchmarks/measured/speed_page.py [--rounds 3] [--model yolox.onnx] [--print] [RECORDING ...]

Without recordings: the sample in `bags/`, and the seed rig, which is simulated (three lidars of 30 000 points, eight
cameras of 640 x 480). Recordings that are given come in addition; lidcam finds out the settings of those itself, and
the straight script takes those of a road. With a model both look at all images of them. The peer is
`straight_script.py`, with the same filters and detectors switched on. A round is one run of each program; rounds follow
each other, so that all see the same machine. With --print the page stays as it is.
"""

import argparse
import json
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from rosbags.rosbag1 import Reader, Writer
from side_by_side import table

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "performance.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
SEED_SECONDS = 1.5
LONGER = 10
SAME_FILTERS = ("--set", "combine.outliers.std_ratio=0.2")  # what the straight script has

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

    name: str
    recording: Path
    lidcam: tuple[str, ...]
    script: tuple[str, ...]


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
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--print", action="store_true", dest="prints")
    options = parser.parse_args()
    lines = [_machine(), ""]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in _cases(options.recordings, options.model, folder):
            lines += [*_section(case, options.rounds, folder), ""]
    for script in ("velodyne.py", "filters.py"):
        lines += ["```", *_said([sys.executable, str(ROOT / "benchmarks" / script)]).splitlines(), "```", ""]
    text = "\n".join(lines)
    print(text)
    if not options.prints:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")


def _machine() -> str:
    return f"{os.cpu_count()} cores; one copies memory at {_bandwidth_gib_per_s():.1f} GiB/s."


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
    settings = "--config", "sandbox", *SAME_FILTERS
    seed = folder / "seed.bag"
    _said([*_lidcam("simulate"), "sandbox", str(seed), "--duration", str(SEED_SECONDS), "--quiet"])
    sandbox = "--ground", "0.02", "--link", "0.12"
    network = (("--model-2d", str(model)), ("--model", str(model))) if model else ((), ())
    return [
        Case("sample", ROOT / "bags" / "sandbox.bag", settings, sandbox),
        Case("seed rig", seed, settings, sandbox),
        *(Case(path.stem, path, (*SAME_FILTERS, *network[0]), network[1]) for path in recordings),
    ]


def _section(case: Case, rounds: int, folder: Path) -> list[str]:
    """The tables of one recording."""
    runs: dict[str, list[Run]] = {"lidcam, 1 worker": [], "lidcam, 2 workers": [], "straight script": []}
    for _ in range(rounds):
        runs["lidcam, 1 worker"].append(_run_lidcam(case, folder, 1))
        runs["lidcam, 2 workers"].append(_run_lidcam(case, folder, 2))
        runs["straight script"].append(_run_script(case, folder))
    one, two, script = runs.values()
    rows = [
        [
            name,
            f"{_middle(found, 'frames_per_second'):.2f}",
            f"{median(a.frames_per_second / b.frames_per_second for a, b in zip(found, script, strict=True)):.2f}",
            f"{median(run.processor_s / run.frames * 1e3 for run in found):.0f}",
            f"{_middle(found, 'peak_mib'):.0f}",
            f"{_middle(found, 'load'):.1f}",
        ]
        for name, found in runs.items()
    ]
    head = ["", "frames/s", "times the script", "processor ms a frame, with the start", "peak MiB", "load"]
    ratio = median(a.frames_per_second / b.frames_per_second for a, b in zip(two, one, strict=True))
    lines = [f"### {case.name}: {one[0].frames} frames", "", *table(head, rows)]
    lines += [f"2 workers against 1: {ratio:.2f} times. {_moved(case, one)}", "", *_stages(one, script)]
    if case.recording.suffix == ".bag":
        longer = _repeated(case.recording, LONGER, folder / "longer.bag")
        peak_mib = _run_lidcam(replace(case, recording=longer), folder, 1).peak_mib
        longer.unlink()
        once_mib = _middle(one, "peak_mib")
        lines += [
            f"Memory of {LONGER} times as many frames: {peak_mib:.0f} MiB, {peak_mib / once_mib:.2f} times as much."
        ]
    return lines


def _moved(case: Case, runs: Sequence[Run]) -> str:
    """What a frame's bytes would cost if they were only copied."""
    read_mib, written_mib = (
        size / runs[0].frames / (1 << 20) for size in (case.recording.stat().st_size, runs[0].written)
    )
    ms = 2 * (read_mib + written_mib) / 1024 / _bandwidth_gib_per_s() * 1e3
    return f"A frame is {read_mib:.2f} MiB read and {written_mib:.2f} MiB written: {ms:.2f} ms at the speed of memory."


def _stages(runs: Sequence[Run], script: Sequence[Run]) -> list[str]:
    """Milliseconds of the clock by stage, of one worker and of the script."""
    rows = []
    for stage, (theirs, ours) in STAGES.items():
        ours_ms, theirs_ms = (_sum(found, names) for found, names in ((runs, ours), (script, theirs)))
        if ours_ms or theirs_ms:
            rows.append([stage, f"{ours_ms:.2f}" if ours else "", f"{theirs_ms:.2f}", ""])
    shown = {name for _, names in STAGES.values() for name in names}
    rest = [name for name in runs[0].stages_ms if name not in shown]
    rows += [[name, f"{_sum(runs, (name,)):.2f}", "", "lidcam alone"] for name in rest if _sum(runs, (name,)) >= 0.05]
    return list(table(["stage, ms a frame", "lidcam, 1 worker", "straight script", ""], rows))


def _sum(runs: Sequence[Run], names: Sequence[str]) -> float:
    return median(sum(run.stages_ms.get(name, 0.0) for name in names) for run in runs)


def _middle(runs: Sequence[Run], name: str) -> float:
    return median(float(getattr(run, name)) for run in runs)


def _lidcam(command: str) -> list[str]:
    return [sys.executable, "-m", "lidcam", command]


def _run_lidcam(case: Case, folder: Path, workers: int) -> Run:
    out = folder / "lidcam.mcap"
    command = [*_lidcam("process"), str(case.recording), str(out), "--json", "-", "--workers", str(workers)]
    return _run([*command, "--overwrite", *case.lidcam], out)


def _run_script(case: Case, folder: Path) -> Run:
    out = folder / "script.mcap"
    script = Path(__file__).with_name("straight_script.py")
    return _run([sys.executable, str(script), str(case.recording), str(out), *case.script], out)


def _run(command: list[str], out: Path) -> Run:
    """One run; ends with the command's own message if it fails."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as complained:
        process = subprocess.Popen(command, stdout=said, stderr=complained, cwd=ROOT, env=_environment())
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


def _said(command: list[str]) -> str:
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=_environment()).stdout


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


WITHOUT_HEADER = {"tf2_msgs/msg/TFMessage", "std_msgs/msg/Float64"}
"""Of the types of the recordings here; all others begin with one."""


def _repeated(recording: Path, times: int, out: Path) -> Path:
    """A ROS 1 recording played several times in a row, stamps and log times moved on."""
    with Reader(recording) as reader, Writer(out) as writer:
        span_ns = reader.end_time - reader.start_time + 100_000_000
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for c in reader.connections
        }
        for turn in range(times):
            for connection, log_ns, data in reader.messages():
                shift_ns = turn * span_ns
                if connection.msgtype not in WITHOUT_HEADER:
                    seconds, nanoseconds = struct.unpack_from("<II", data, 4)
                    stamp_ns = seconds * 10**9 + nanoseconds + shift_ns
                    data = data[:4] + struct.pack("<II", *divmod(stamp_ns, 10**9)) + data[12:]
                writer.write(connections[connection.id], log_ns + shift_ns, data)
    return out


if __name__ == "__main__":
    main()
