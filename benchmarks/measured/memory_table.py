"""Memory of a run, by the length of the recording and the number of processes; writes docs/performance.md.

    python benchmarks/measured/memory_table.py [--frames 15 1500] [--workers 1 2 4] [--print] [RECORDING.bag ...]

A recording (`bags/sandbox.bag` without any) is played as often as its frames are wanted. Nothing is timed, so other
programs may run meanwhile. Linux: /proc says how much memory is used.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pages import LIDCAM, ROOT, repeated, table, write_part
from rosbags.rosbag1 import Reader

PAGE = ROOT / "docs" / "performance.md"
STEP_S = 0.05


@dataclass(frozen=True)
class Peaks:
    """Largest figures of a run."""

    frames: int
    processes: int  # at once
    first_mib: float  # resident set of the first process
    all_mib: float  # sum of proportional set sizes: a page that several processes share counts once
    written: int  # bytes of the output


def main() -> None:
    """Measure, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path, default=[ROOT / "bags" / "sandbox.bag"])
    parser.add_argument("--frames", nargs="+", type=int, default=[15, 1500])
    parser.add_argument("--workers", nargs="+", type=int, default=[1, 2, 4])
    parser.add_argument("--print", action="store_true", dest="prints")
    options = parser.parse_args()
    rows = []
    for recording in options.recordings:
        for frames in options.frames:
            for workers, peaks in _measured(recording, frames, options.workers):
                counts = str(peaks.frames), str(workers), str(peaks.processes)
                mib = f"{peaks.first_mib:.0f}", f"{peaks.all_mib:.0f}", f"{peaks.written / 2**20:.0f}"
                rows.append([recording.stem, *counts, *mib])
                print(rows[-1], file=sys.stderr, flush=True)
    head = ["", "frames", "workers", "processes", "first process, MiB", "all, MiB", "written, MiB"]
    text = "\n".join(table(head, rows))
    print(text)
    if not options.prints:
        write_part(PAGE, "memory", text)


def _measured(recording: Path, frames: int, workers: list[int]) -> Iterator[tuple[int, Peaks]]:
    """The figures of a recording that is as long as that, by the number of workers."""
    with Reader(recording) as reader:
        clouds = [c.msgcount for c in reader.connections if c.msgtype == "sensor_msgs/msg/PointCloud2"]
        own, own_s = min(clouds), (reader.end_time - reader.start_time) / 1e9
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        longer = repeated(recording, -(-frames // own), folder / recording.name) if frames > own else recording
        part = ["--duration", f"{own_s * frames / own}"] if frames < own else []
        for count in workers:
            out = folder / "out.mcap"
            command = [*LIDCAM, "process", str(longer), str(out), "--overwrite", "--json"]
            yield count, _peaks([*command, "--workers", str(count), *part], out)


def _peaks(command: list[str], out: Path) -> Peaks:
    first_kib = all_kib = processes = 0
    with tempfile.TemporaryFile("w+") as out_text:
        run = subprocess.Popen(command, stdout=out_text, cwd=ROOT)
        while run.poll() is None:
            sizes_kib = [size for pid in _family(run.pid) if (size := _used_kib(f"{pid}/smaps_rollup", "Pss:"))]
            first_kib = max(first_kib, _used_kib(f"{run.pid}/status", "VmHWM:"))
            all_kib, processes = max(all_kib, sum(sizes_kib)), max(processes, len(sizes_kib))
            time.sleep(STEP_S)
        out_text.seek(0)
        if run.returncode:
            raise SystemExit(f"{' '.join(command)}: exit code {run.returncode}")
        frames = json.load(out_text)["frames"]
    return Peaks(frames, processes, first_kib / 1024, all_kib / 1024, out.stat().st_size)


def _family(pid: int) -> Iterator[int]:
    """A process and those that it has started, and so on."""
    yield pid
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text(encoding="ascii").split():
                yield from _family(int(child))


def _used_kib(name: str, key: str) -> int:
    """A figure of a process in /proc; 0 if it has ended."""
    with suppress(OSError):
        for line in Path("/proc", name).read_text(encoding="ascii").splitlines():
            if line.startswith(key):
                return int(line.split()[1])
    return 0


if __name__ == "__main__":
    main()
