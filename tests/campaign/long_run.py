"""A long recording: `python tests/campaign/long_run.py [--recorded-minutes M] [--count N] [--seed S]`.

Every case processes M minutes at 10 Hz; every other one with a Rerun recording, too. Memory and rate must be at the end
what they were at the start, and the outputs must hold every frame in their summaries. The figures are printed.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from random import Random

from common import Outcome, campaign, run_child  # isort: skip
import numpy as np
from builders import odometry, raw, write_mcap
from mcap.reader import make_reader
from small_drive import START_NS, STEP_NS, small_drive

from lidcam.pipeline.core.messages import RawMessage
from lidcam.processing import RunObserver, process_recording
from lidcam.run.job import make_job
from lidcam.run.tally import RunProgress

VARIANTS = 20
"""Frames after which the recording repeats itself."""

MAX_GROWTH_MIB = 64
"""Of memory from the second tenth of a run to the last."""

MIN_RATE = 0.5
"""Of the last tenth of a run, against that of the second; the machine may have other work."""


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--recorded-minutes", type=float, default=0.05)
    parser.add_argument("--process", nargs="+", type=Path, help=argparse.SUPPRESS)
    options, others = parser.parse_known_args()
    if options.process:
        _process(*options.process)
        return 0
    frames = round(600 * options.recorded_minutes)
    limit_s = 60 + 2.0 * frames
    try_one = partial(_try_case, frames=frames, limit_s=limit_s)
    return campaign("long_run", try_one, count=2, arguments=others, max_case_s=2 * limit_s)


def _try_case(number: int, _: Random, *, frames: int, limit_s: float) -> Outcome:
    with tempfile.TemporaryDirectory(prefix="long_run-") as folder:
        recording, output = Path(folder, "in.mcap"), Path(folder, "out.mcap")
        outputs = [output, *([Path(folder, "out.rrd")] if number % 2 else [])]
        write_mcap(recording, _recorded(frames), "zstd")
        child = run_child([sys.executable, __file__, "--process", recording, *outputs], timeout_s=limit_s)
        if child.returncode or child.is_hung:
            return Outcome("does not end well", is_fault=True, detail=child.stderr)
        samples = json.loads(child.stdout.splitlines()[-1])
        found = _frames(output)
        size_mib = sum(path.stat().st_size for path in outputs) / 2**20
        early, late = _tenths(samples, 2), _tenths(samples, 10)
        kind = " and ".join(path.suffix for path in outputs)
        detail = (
            f"{kind}: {found} of {frames} frames in {child.seconds:.0f} s; "
            f"at the start {early[0]:.1f} frames a second, {early[1]:.0f} MiB; "
            f"at the end {late[0]:.1f}, {late[1]:.0f} MiB; "
            f"outputs {size_mib:.0f} MiB"
        )
        print(detail, flush=True)
        faults = {
            "frames are missing": found != frames,
            "memory grows": late[1] - early[1] > MAX_GROWTH_MIB,
            "becomes slower": late[0] < MIN_RATE * early[0] and frames > 1000,
        }
        fault = next((told for told, is_so in faults.items() if is_so), "")
        return Outcome(f"{kind}: {fault or 'as at the start'}", bool(fault), detail)


def _tenths(samples: list[list[float]], tenth: int) -> tuple[float, float]:
    """Frames a second and most MiB of a tenth of a run; rows of `samples` are frames done, seconds, MiB."""
    done = np.array(samples)
    first, last = (int((len(done) - 1) * share / 10) for share in (tenth - 1, tenth))
    rate = (done[last, 0] - done[first, 0]) / max(done[last, 1] - done[first, 1], 1e-9)
    return float(rate), float(done[first : last + 1, 2].max())


def _process(recording: Path, *outputs: Path) -> None:
    """Process a recording as `lidcam process` does, and print samples of how it went."""
    samples = []

    class Watch(RunObserver):
        def advanced(self, progress: RunProgress) -> None:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
            samples.append((progress.frames, time.monotonic(), pages * os.sysconf("SC_PAGESIZE") / 2**20))

    process_recording(make_job(recording, outputs), Watch())
    print(json.dumps(samples[:: max(len(samples) // 1000, 1)]))


def _frames(output: Path) -> int:
    """How many frames the summary of an MCAP has: it opens at once."""
    with output.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        return 0
    (fused,) = [number for number, channel in summary.channels.items() if channel.topic == "/fused/detections"]
    return summary.statistics.channel_message_counts[fused]


def _recorded(frames: int) -> Iterator[RawMessage]:
    """The small drive again and again, along a circle of 60 m."""
    static, *drive = small_drive("cdr", frames=VARIANTS, motion="none", kinds=("images", "boxes"))
    size = len(drive) // VARIANTS
    yield static
    for frame in range(frames):
        at_ns = START_NS + frame * STEP_NS
        seconds, rest_ns = divmod(at_ns, 10**9)
        stamp = seconds.to_bytes(4, "little") + rest_ns.to_bytes(4, "little")
        angle = frame / 300
        pose = odometry(stamp_ns=at_ns, position=(30 * np.sin(angle), 30 - 30 * np.cos(angle), 0.0))
        yield raw("/odom", "nav_msgs/msg/Odometry", pose, at_ns)
        first = frame % VARIANTS * size
        for message in drive[first : first + size]:  # in CDR, each begins with a header
            data = bytes(message.data[:4]) + stamp + bytes(message.data[12:])
            log_time_ns = at_ns + message.log_time_ns - message.stamp_ns
            yield message._replace(stamp_ns=at_ns, log_time_ns=log_time_ns, data=data)


if __name__ == "__main__":
    sys.exit(main())
