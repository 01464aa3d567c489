"""Velodyne packets to points beside velodyne-decoder (C++), on the same packets, alternating in one run.

    python benchmarks/velodyne.py [--rounds 50] [--shared ../shared]

Scans: one turn of a VLP-16 with a return for every firing (29 000 points), and where the recordings are at hand a
VLP-16 with two returns and a VLS-128. Ours starts from the bytes of the message and ends with a `PointCloud`; theirs
starts from packets already in its own vector and ends with a structured array. Milliseconds are medians; both run on
one core.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import velodyne_decoder as vd

from lidcam.bags.simulator.recorder.messages import MessageFactory
from lidcam.bags.simulator.sensors.beams import VelodyneSensor
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.settings.recording import VelodyneConfig
from lidcam.readers.open import open_recording
from lidcam.readers.velodyne.decoder import VelodyneDecoder
from lidcam.readers.velodyne.scan import SCAN, parse_velodyne_scan

START_NS = 1_600_000_000 * 10**9


def synthetic_scan() -> RawMessage:
    """One turn of a VLP-16, all ranges between 1 and 100 m."""
    sensor, rng, make = VelodyneSensor("VLP-16", START_NS), np.random.default_rng(0), MessageFactory(2)
    shape = (round(sensor.packets_per_turn) * sensor.firings_per_packet, 16)
    packets = sensor.encode(0, rng.uniform(1, 100, shape), rng.integers(0, 256, shape).astype(np.uint8))
    scan = make.scan(START_NS, "velodyne", packets.stamps_ns, packets.payload)
    return RawMessage(START_NS, START_NS, (0, 0), make.serialize(scan), Channel("/packets", SCAN, "cdr"))


def recorded_scan(path: Path) -> RawMessage:
    """The second scan of a recording; the first may be partial."""
    with open_recording([path]) as recording:
        scans = (message for message in recording.messages() if message.channel.msgtype == SCAN)
        message = next(islice(scans, 1, None))
        return message._replace(data=bytes(message.data))


def milliseconds(step: Callable[[], object]) -> float:
    """Wall time of one call."""
    start_s = time.perf_counter()
    step()
    return (time.perf_counter() - start_s) * 1e3


def main() -> None:
    """Print one line per scan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--shared", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    scans = {"VLP-16, synthetic": synthetic_scan()}
    for name, folder in (("VLP-16, dual return", "vlp16"), ("VLS-128", "vls128")):
        for path in (options.shared / "data/velodyne_packets" / folder).glob("*/metadata.yaml"):
            scans[name] = recorded_scan(path.parent)
    for name, message in scans.items():
        found = parse_velodyne_scan(message)
        stamped = zip(found.stamps_ns, found.payload, strict=True)
        packets = vd.PacketVector([vd.VelodynePacket(at / 1e9, data.tolist()) for at, data in stamped])
        decode = VelodyneDecoder(VelodyneConfig())
        judge = vd.ScanDecoder(vd.Config(min_range=0.0, max_range=300.0))
        steps = partial(decode, message), partial(judge.decode, packets, as_pcl_structs=True)
        rounds = [[milliseconds(step) for step in steps] for _ in range(options.rounds)]
        ours_ms, theirs_ms = (statistics.median(column) for column in zip(*rounds, strict=True))
        print(
            f"{name:20s} {len(decode(message)):7d} points  lidcam {ours_ms:6.2f} ms  "
            f"velodyne-decoder {theirs_ms:6.2f} ms  ratio {ours_ms / theirs_ms:.2f}"
        )


if __name__ == "__main__":
    main()
