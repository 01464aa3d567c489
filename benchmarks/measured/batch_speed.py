"""Speed of a batch by its engine: one local job at a time, two, and two with Ray, in turn.

    python benchmarks/measured/batch_speed.py [--recordings 40] [--seconds 3] [--rounds 3]

Recordings are simulated in three formats and repeated under other names; one in eight is broken, in five ways. Each
job has one worker. Prints the medians: time of the whole batch, processor time of its jobs, and for Ray what its start
and end take, which is taken off before the comparison.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

LIDCAM = (sys.executable, "-m", "lidcam")
STRIDE = ("--set", "lidars.*.firing_stride=4", "--set", "cameras.*.jpeg_quality=40")
ENGINES = {
    "local, 1": ("--engine", "local", "--jobs", "1"),
    "local, 2": ("--engine", "local", "--jobs", "2"),
    "ray, 2": ("--engine", "ray", "--jobs", "2"),
}
EMPTY = "from lidcam.batch.ray import RayEngine; [*RayEngine(2, 1, None).outcomes([])]"
BROKEN_ONE_IN = 8


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    with TemporaryDirectory(prefix="batch-speed-") as name:
        folder = Path(name)
        record(folder / "logs", options.recordings, options.seconds)
        walls: dict[str, list[float]] = {name: [] for name in (*ENGINES, "start and end of Ray")}
        processor: dict[str, list[float]] = {name: [] for name in ENGINES}
        for number in range(options.rounds):
            for name, arguments in ENGINES.items():
                out = folder / "out"
                command = [*LIDCAM, "batch", str(folder / "logs"), "--out", str(out), "--workers", "1", *arguments]
                started = time.monotonic()
                done = subprocess.run([*command, "--json", "-q"], check=False, capture_output=True)
                walls[name].append(time.monotonic() - started)
                rows = json.loads(done.stdout)["jobs"]
                processor[name].append(sum(row["processor_s"] for row in rows))
                states = {
                    state: sum(row["state"] == state for row in rows) for state in ("done", "incomplete", "failed")
                }
                print(f"round {number}: {name}: {walls[name][-1]:.1f} s, {states}", file=sys.stderr, flush=True)
                shutil.rmtree(out)
            started = time.monotonic()
            subprocess.run([sys.executable, "-c", EMPTY], check=True)
            walls["start and end of Ray"].append(time.monotonic() - started)
    wall = {name: median(values) for name, values in walls.items()}
    for name, seconds in wall.items():
        jobs = f", processor time of the jobs {median(processor[name]):.1f} s" if name in processor else ""
        print(f"{name}: {seconds:.1f} s{jobs}")
    without = [ray - start for ray, start in zip(walls["ray, 2"], walls["start and end of Ray"], strict=True)]
    print(f"two local jobs against one: {ratio(walls['local, 1'], walls['local, 2']):.2f} times as fast")
    print(f"Ray without its start against two local jobs: {ratio(walls['local, 2'], without):.2f} times as fast")


def ratio(slow: list[float], fast: list[float]) -> float:
    """Median of the ratios within a round."""
    return median(one / other for one, other in zip(slow, fast, strict=True))


def record(folder: Path, count: int, seconds: float) -> None:
    """Simulated recordings of three formats, one in `BROKEN_ONE_IN` broken."""
    folder.mkdir()
    originals = []
    for seed, arguments in enumerate(([".bag"], [".mcap"], ["", "--format", "sqlite3"])):
        path = folder.with_name(f"drive{arguments[0]}")
        command = [*LIDCAM, "simulate", "sandbox", str(path), "--seed", str(seed), "--duration", str(seconds), "-q"]
        subprocess.run([*command, *arguments[1:], *STRIDE], check=True)
        originals.append(path)
    bag, mcap, ros2 = originals
    broken = count // BROKEN_ONE_IN
    for number in range(count - broken):
        original = originals[number % len(originals)]
        copied = shutil.copytree if original.is_dir() else shutil.copyfile
        copied(original, folder / f"drive{number:02}{original.suffix}")
    for number in range(broken):
        path, kind = folder / f"broken{number:02}", number % 5
        if kind == 0:
            path.with_suffix(".bag").write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
        elif kind == 1:
            path.with_suffix(".bag").write_bytes(b"no recording")
        elif kind == 2:
            path.with_suffix(".mcap").touch()
        elif kind == 3:
            content = bytearray(mcap.read_bytes())
            content[len(content) // 2 : len(content) // 2 + 1000] = bytes(1000)
            path.with_suffix(".mcap").write_bytes(content)
        else:
            path.mkdir()
            shutil.copyfile(ros2 / "metadata.yaml", path / "metadata.yaml")


if __name__ == "__main__":
    main()
