"""Synchronisation of 3 lidars and 8 cameras, 110 000 messages without data: the rules of lidcam against those of ROS.

    python benchmarks/synchronisation.py [--rounds 5] [--frames 10000]

Both run over the same messages, alternating, in one process: `lidars` is the default, `all` is message_filters' own
(`sync.required`). Prints the median of microseconds a message and of their ratio, for each policy: with every sensor
well, with a camera that dies, and with cameras at half the rate (where `all` is quick because it drops most messages).
The target: under 20 microseconds a message, 0.2 ms a frame of eleven sensors.
"""

import argparse
import random
import statistics
import time
from collections.abc import Sequence

from pipeline.core.messages import Channel, RawMessage
from pipeline.core.settings.sync import SyncConfig
from pipeline.stages.sync.synchronize import synchronize

LIDARS = [f"/lidar{number}" for number in range(3)]
CAMERAS = [f"/cam{number}" for number in range(8)]
PERIOD_NS = 100_000_000
POLICIES = ("approximate_time", "approximate_time_python", "nearest")


def recorded(frames: int, *, dead_camera: bool = False, camera_step: int = 1) -> list[RawMessage]:
    """Messages in the order of log time, with 2 ms of jitter in their stamps."""
    rng = random.Random(0)
    messages: list[RawMessage] = []
    for place, topic in enumerate(LIDARS + CAMERAS):
        channel = Channel(topic, "sensor_msgs/msg/Image", "cdr")
        step = camera_step if topic in CAMERAS else 1
        last = frames // 10 if dead_camera and topic == CAMERAS[0] else frames
        for frame in range(0, last, step):
            stamp_ns = frame * PERIOD_NS + place * 3_000_000 + rng.randrange(2_000_000)
            latency_ns = 20_000_000 + rng.randrange(30_000_000)
            messages.append(RawMessage(stamp_ns, stamp_ns + latency_ns, (0, len(messages)), b"", channel))
    return sorted(messages, key=lambda message: (message.log_time_ns, message.order))


def measure(messages: Sequence[RawMessage], config: SyncConfig, required: Sequence[str] | None) -> tuple[float, int]:
    """Seconds, and the number of frames."""
    started = time.perf_counter()
    found = synchronize(
        messages, LIDARS + CAMERAS, config, reference=LIDARS[0], required=required, on_drop=lambda _drop: None
    )
    frames = sum(1 for _ in found)
    return time.perf_counter() - started, frames


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=10_000)
    arguments = parser.parse_args()
    cases = {
        "all well": recorded(arguments.frames),
        "a camera dies": recorded(arguments.frames, dead_camera=True),
        "cameras at half rate": recorded(arguments.frames, camera_step=2),
    }
    print(f"{'policy':24} {'case':21} {'messages':>8}  us a message: all  lidars  ratio   frames: all  lidars")
    for policy in POLICIES:
        config = SyncConfig(policy=policy)
        for name, messages in cases.items():
            times: dict[str, list[float]] = {"all": [], "lidars": []}
            frames: dict[str, int] = {}
            for _ in range(arguments.rounds):
                for label, required in (("all", None), ("lidars", LIDARS)):
                    seconds, frames[label] = measure(messages, config, required)
                    times[label].append(1e6 * seconds / len(messages))
            ratio = statistics.median(b / a for a, b in zip(times["all"], times["lidars"], strict=True))
            full, partial = statistics.median(times["all"]), statistics.median(times["lidars"])
            print(
                f"{policy:24} {name:21} {len(messages):8} {full:18.2f} {partial:7.2f} {ratio:6.2f} "
                f"{frames['all']:13} {frames['lidars']:7}"
            )


if __name__ == "__main__":
    main()
