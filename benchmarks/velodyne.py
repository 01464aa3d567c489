"""Velodyne packets to points beside velodyne-decoder (C++), on the same packets, alternating in one run.

    python benchmarks/velodyne.py [--rounds 50] [--shared ../shared]

Scans: one turn of a VLP-16 with a return for every firing (29 000 points), and where the recordings are at hand a
VLP-16 with two returns and a VLS-128. Ours starts from the bytes of the message and ends with a `PointCloud`; theirs
starts from packets already in its own vector and ends with a structured array. Milliseconds are medians; both run on
one core.
"""

import argparse
import os
import sqlite3
import statistics
import struct
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import velodyne_decoder as vd

from lidcam.bags.simulator.sensors.beams import VelodyneSensor
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.settings.recording import VelodyneLidarConfig
from lidcam.readers.velodyne.decoder import VelodyneDecoder
from lidcam.readers.velodyne.scan import SCAN, parse_velodyne_scan

CHANNEL = Channel("/velodyne_packets", SCAN, "cdr")


def synthetic_scan() -> RawMessage:
    """One turn of a VLP-16, all ranges between 1 and 100 m."""
    sensor = VelodyneSensor("VLP-16", 1_600_000_000_000_000_000)
    rng = np.random.default_rng(0)
    shape = (round(sensor.packets_per_turn) * sensor.firings_per_packet, 16)
    packets = sensor.encode(0, rng.uniform(1, 100, shape), rng.integers(0, 256, shape).astype(np.uint8))
    sec, nanosec = divmod(sensor.start_ns, 10**9)
    data = bytearray(struct.pack("<4xII I12s I", sec, nanosec, 9, b"velodyne", len(packets.payload)))
    data[:2] = b"\x00\x01"
    for stamp_ns, payload in zip(packets.stamps_ns.tolist(), packets.payload, strict=True):
        data += struct.pack("<II1206s2x", *divmod(stamp_ns, 10**9), payload.tobytes())
    return RawMessage(sensor.start_ns, sensor.start_ns, (0, 0), bytes(data[:-2]), CHANNEL)


def recorded_scan(path: Path) -> RawMessage:
    """The second scan of a rosbag2 in SQLite; the first may be partial."""
    with sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True) as database:
        [(log_time_ns, data)] = database.execute("SELECT timestamp, data FROM messages ORDER BY id LIMIT 1 OFFSET 1")
    sec, nanosec = struct.unpack_from("<II", data, 4)
    return RawMessage(sec * 10**9 + nanosec, log_time_ns, (0, 0), data, CHANNEL)


def milliseconds(step: Callable[[], object]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    step()
    return (time.perf_counter() - start) * 1e3


def main() -> None:
    """Print one line per scan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--shared", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    arguments = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

    scans = {"VLP-16, synthetic": synthetic_scan()}
    for name, folder in (("VLP-16, dual return", "vlp16"), ("VLS-128", "vls128")):
        for path in (arguments.shared / "data/velodyne_packets" / folder).glob("*/*.db3"):
            scans[name] = recorded_scan(path)
    for name, message in scans.items():
        found = parse_velodyne_scan(message)
        packets = vd.PacketVector(
            [
                vd.VelodynePacket(at / 1e9, data.tolist())
                for at, data in zip(found.stamps_ns, found.payload, strict=True)
            ]
        )
        decode, judge = (
            VelodyneDecoder(VelodyneLidarConfig()),
            vd.ScanDecoder(vd.Config(min_range=0.0, max_range=300.0)),
        )
        ours, theirs = [], []
        for _ in range(arguments.rounds):
            ours.append(milliseconds(partial(decode, message)))
            theirs.append(milliseconds(partial(judge.decode, packets, as_pcl_structs=True)))
        ours_ms, theirs_ms = statistics.median(ours), statistics.median(theirs)
        print(
            f"{name:20s} {len(decode(message)):7d} points  lidcam {ours_ms:6.2f} ms  "
            f"velodyne-decoder {theirs_ms:6.2f} ms  ratio {ours_ms / theirs_ms:.2f}"
        )


if __name__ == "__main__":
    main()
