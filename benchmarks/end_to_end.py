"""lidcam against what a user would write instead, on the same recording, alternating in one run.

    python benchmarks/end_to_end.py [--rounds 3] [--shared ../shared] [RECORDING ...]

Without recordings: the sample in `bags/`, and, where the shared folder is present, 15 KITTI frames (`K.bag`, written to
a temporary folder) with a 2D network. The peer is `shared/tools/baseline.py`: one script on the same libraries,
with the same filters and detectors switched on. Both report frames a second from the first byte read to the last byte
written, imports left out. Where the shared folder is absent lidcam runs alone. Peak memory is measured on the recording
and on ten times its length.
"""

import argparse
import json
import os
import re
import statistics
import struct
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from rosbags.rosbag1 import Reader, Writer

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Case:
    """One recording and how both programs are told to treat it."""

    name: str
    recording: Path
    lidcam: tuple[str, ...]
    peer: tuple[str, ...]


@dataclass(frozen=True)
class Timing:
    """Frames a second, milliseconds a frame by stage, and peak memory of the process."""

    frames_per_second: float
    stages_ms: dict[str, float]
    peak_mib: float


def run_lidcam(case: Case, out: Path) -> Timing:
    """One run of the installed command."""
    program = Path(sys.executable).with_name("lidcam-process")
    text, peak_mib = _run([str(program), str(case.recording), str(out / "l.mcap"), "--json", *case.lidcam])
    timing = json.loads(text)["timing"]
    return Timing(timing["frames_per_second"], timing["stage_ms"], peak_mib)


def run_peer(case: Case, out: Path, shared: Path) -> Timing:
    """One run of the straight script."""
    script = str(shared / "tools" / "baseline.py")
    # Open3D's wheel wants libusb, which a bare machine lacks.
    start = (
        "import runpy, sys; from bags.simulator.world.open3d_runtime import load_libusb; load_libusb(); "
        "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    )
    text, peak_mib = _run([sys.executable, "-c", start, script, str(case.recording), str(out / "p.mcap"), *case.peer])
    speed = re.search(r"([\d.]+) frames/s", text)
    if speed is None:
        raise SystemExit(f"the peer said: {text}")
    stages = re.findall(r"([a-z0-9 ]+?) ([\d.]+)(?= |$)", text.split("|")[0])
    return Timing(float(speed.group(1)), {name.strip(): float(ms) for name, ms in stages}, peak_mib)


def _run(command: list[str]) -> tuple[str, float]:
    """Output of a command and its peak memory in MiB; ends with the command's own message if it fails."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(command, stdout=out, stderr=err)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}\n{err.read()}")
        return out.read(), usage.ru_maxrss / 1024


def cases(arguments: argparse.Namespace, folder: Path) -> list[Case]:
    """What to measure."""
    sandbox_lidcam = ("--config", str(ROOT / "config" / "sandbox.yaml"))
    sandbox_peer = ("--sor", "--ground", "0.02", "--eps", "0.12")
    model = arguments.shared / "weights" / "yolox_nano.onnx"
    with_network = (("--model-2d", str(model)), ("--yolox", str(model))) if model.exists() else ((), ())
    filters = ("--set", "combine.outliers.std_ratio=0.2")  # what the peer has
    if arguments.recordings:
        return [Case(p.name, p, filters + with_network[0], ("--sor", *with_network[1])) for p in arguments.recordings]
    found = [Case("sandbox.bag", ROOT / "bags" / "sandbox.bag", sandbox_lidcam + filters, sandbox_peer)]
    maker = arguments.shared / "tools" / "real_bags.py"
    if maker.exists():
        recording = folder / "K.bag"
        subprocess.run(
            [sys.executable, str(maker), "kitti_raw_sequence", str(recording)], check=True, stdout=sys.stderr
        )
        found.append(Case("K.bag", recording, filters + with_network[0], ("--sor", *with_network[1])))
    return found


WITHOUT_HEADER = {"tf2_msgs/msg/TFMessage", "std_msgs/msg/Float64"}
"""Of the types of the recordings here; all others begin with one."""


def repeated(recording: Path, times: int, out: Path) -> Path:
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


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    arguments = parser.parse_args()
    arguments.shared = arguments.shared.resolve()
    peer_here = (arguments.shared / "tools" / "baseline.py").exists()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in cases(arguments, folder):
            runs: dict[str, list[Timing]] = {"lidcam": [], "peer": []}
            for _ in range(arguments.rounds):
                runs["lidcam"].append(run_lidcam(case, folder))
                if peer_here:
                    runs["peer"].append(run_peer(case, folder, arguments.shared))
            print(f"\n{case.name}")
            for program, timings in runs.items():
                if timings:
                    speed = statistics.median(timing.frames_per_second for timing in timings)
                    peak = statistics.median(timing.peak_mib for timing in timings)
                    print(f"  {program:7} {speed:6.2f} frames/s   peak memory {peak:.0f} MiB")
                    names = timings[0].stages_ms
                    print(
                        "          "
                        + ", ".join(f"{n} {statistics.median(t.stages_ms[n] for t in timings):.1f}" for n in names)
                        + "  (ms a frame)"
                    )
            if peer_here:
                ratios = [
                    a.frames_per_second / b.frames_per_second for a, b in zip(runs["lidcam"], runs["peer"], strict=True)
                ]
                print(f"  ratio   {statistics.median(ratios):6.2f}   (rounds: {', '.join(f'{r:.2f}' for r in ratios)})")
            if case.recording.suffix == ".bag":
                longer = repeated(case.recording, 10, folder / "longer.bag")
                once = statistics.median(timing.peak_mib for timing in runs["lidcam"])
                ten = run_lidcam(replace(case, recording=longer), folder).peak_mib
                longer.unlink()
                print(f"  memory  {once:.0f} MiB once, {ten:.0f} MiB ten times in a row: ratio {ten / once:.3f}")


if __name__ == "__main__":
    main()
