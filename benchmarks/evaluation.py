"""How long `lidcam evaluate` takes on a long result, and how much memory, on one core.

    python benchmarks/evaluation.py [--frames 10000] [--objects 30]

The result is made up: objects that drive in circles, found by two sources with small errors, some missed, some false,
all with track ids. Beside the whole, the same for a tenth of the frames: time and memory should grow no faster than the
frames. The peer only reads the same boxes into objects, with the mcap library and rosbags.
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
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipeline.core.arrays import F64, I64
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.ros.messages import ROS2
from writers.messages.detections import detections_3d

ROOT = Path(__file__).resolve().parent.parent
MODEL = ROOT / "tests" / "golden" / "crossing.mcap"
"""A result: the made one has its settings and its rig."""

TYPE = "vision_msgs/msg/Detection3DArray"
CLASSES = ("car", "pedestrian", "bicycle", "truck")
SIZES_M = np.array([[4.4, 1.8, 1.5], [0.6, 0.6, 1.75], [1.8, 0.6, 1.7], [7.5, 2.5, 3.2]])
FRAME_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Cost:
    """What a command took.

    Attributes:
        seconds: Processor time.
        peak_mib: Peak of its memory.
    """

    seconds: float
    peak_mib: float


def main() -> None:
    """Make results, evaluate them, print the costs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--objects", type=int, default=30)
    options = parser.parse_args()
    costs = []
    with tempfile.TemporaryDirectory() as folder:
        for frames in (max(options.frames // 10, 1), options.frames):
            result, figures = Path(folder) / f"{frames}.mcap", Path(folder) / f"{frames}.json"
            write_result(result, frames, options.objects)
            cost = run_on_one_core(
                [sys.executable, "-m", "lidcam", "evaluate", str(result), "--json-file", str(figures)]
            )
            peer_s = read_into_objects(result)
            found = json.loads(figures.read_bytes())
            print(
                f"{found['frames_with_truth']} frames of {options.objects} objects: {cost.seconds:.1f} s, "
                f"{cost.peak_mib:.0f} MiB; {cost.seconds / peer_s:.2f} times as long as the peer takes to read them "
                f"({peer_s:.1f} s); recall {found['sources']['fused']['car']['recall']:.3f}, "
                f"HOTA {found['tracking']['fused']['car']['hota']:.3f}"
            )
            costs.append(cost)
    few, many = costs
    growth = f"{many.seconds / few.seconds:.1f} times as long, {many.peak_mib / few.peak_mib:.1f} times the memory"
    print(f"{options.frames / max(options.frames // 10, 1):g} times the frames: {growth}")


def run_on_one_core(command: Sequence[str]) -> Cost:
    """Run a command on the first core that this process may use."""
    core = min(os.sched_getaffinity(0))
    process = subprocess.Popen(["taskset", "--cpu-list", str(core), *command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}")
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def read_into_objects(result: Path) -> float:
    """Processor time of the peer."""
    started, boxes = time.process_time(), 0
    with result.open("rb") as file:
        store = get_typestore(Stores.EMPTY)
        for schema, _, message in make_reader(file).iter_messages():
            assert schema is not None
            if schema.name not in store.types:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            decoded: Any = store.deserialize_cdr(message.data, schema.name)
            boxes += len(decoded.detections)
    assert boxes
    return time.process_time() - started


def write_result(path: Path, frames: int, objects: int) -> None:
    """A result with fused and lidar boxes and the truth, in one chunk after another."""
    random = np.random.default_rng(5)
    radius_m, speed = random.uniform(8, 60, objects), random.uniform(-0.5, 0.5, objects)
    angle, class_ids = random.uniform(0, 2 * np.pi, objects), random.integers(0, len(CLASSES), objects)
    ids = np.arange(objects)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start("ros2", library="benchmark")
        _copy_settings(writer)
        schema = writer.register_schema(TYPE, "ros2msg", ROS2.definition(TYPE).encode())
        topics = ("/fused/detections", "/lidar/detections", "/ground_truth/objects")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in topics]
        for frame in range(frames):
            now = angle + speed * frame * FRAME_NS / 1e9
            centers = np.column_stack([radius_m * np.cos(now), radius_m * np.sin(now), SIZES_M[class_ids, 2] / 2])
            yaws = wrap_angle(now + np.sign(speed) * np.pi / 2)
            stamp_ns = START_NS + frame * FRAME_NS
            for channel, topic in zip(channels, topics, strict=True):
                if topic == topics[2]:
                    message = _message(stamp_ns, centers, yaws, class_ids, np.ones(objects), ids)
                else:
                    found = np.flatnonzero(random.random(objects) > (0.05 if topic == topics[0] else 0.2))
                    noise_m = random.normal(0, 0.15, (len(found), 3)) * SIZES_M[class_ids[found], :1] / 4
                    turned = wrap_angle(yaws[found] + random.normal(0, 0.05, len(found)))
                    far = np.where(random.random(len(found)) < 0.03, 30.0, 0.0)
                    places = centers[found] + noise_m + far[:, None] * [1, 0, 0]
                    message = _message(
                        stamp_ns, places, turned, class_ids[found], random.uniform(0.3, 1, len(found)), ids[found]
                    )
                writer.add_message(channel, stamp_ns, bytes(ROS2.serialize(message)), stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part


def _message(stamp_ns: int, centers: F64, yaws: F64, class_ids: I64, scores: F64, ids: I64) -> Any:
    n = len(yaws)
    boxes = Boxes3D(
        stamp_ns,
        "site",
        np.array(centers),
        SIZES_M[class_ids],
        np.array(yaws),
        scores.astype(np.float32),
        class_ids.astype(np.int32),
        np.zeros(n, np.int32),
        np.zeros((n, 3, 3)),
        np.zeros(n, np.uint8),
        np.full(n, stamp_ns, np.int64),
    )
    columns = detections_3d(boxes, CLASSES, stamp_ns=stamp_ns)
    message = ROS2.deserialize(ROS2.serialize(columns), columns.__msgtype__)
    for detection, number in zip(message.detections, ids.tolist(), strict=True):
        detection.id = str(number)
    return message


def _copy_settings(writer: Writer) -> None:
    """What makes a file a result: the attachments and the metadata of another one."""
    with MODEL.open("rb") as file:
        reader = make_reader(file)
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data
            )
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, dict(metadata.metadata))


if __name__ == "__main__":
    main()
