"""What a recording costs beside what lidcam uses of it: many topics, fast cameras, a million tiny messages.

    OMP_NUM_THREADS=1 python benchmarks/scaling.py [--rounds 3] [--tiny 1000000] [--formats ...] [--cases ...]

A sample is written anew in each format as it is, and with more: 200 topics of 10 Hz; every image twelve times, as of a
camera of 120 Hz (60 Hz where the sample has 5 Hz); a million IMU samples; transforms of wheels at 2 kHz. Each is
opened, the messages that a run uses are read, and it is inspected and processed. Prints the least processor time of all
rounds in milliseconds, and how many times that of the recording as it is, alternating in one process.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from heapq import merge
from itertools import pairwise
from pathlib import Path
from typing import Any

from lidcam.frames import synchronized_topics
from lidcam.inspection import inspect_recording
from lidcam.job import make_job
from lidcam.run import opened, process_recording
from lidcam.settings.choice import choose_settings
from pipeline.core.messages import RawMessage
from readers.open import open_recording

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = {"bag": "sandbox.bag", "bag-lz4": "sandbox.bag", "mcap": "crossing.mcap", "db3": "crossing.mcap"}
IMAGES = {"sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"}
IMAGE_TIMES = 12
TOPICS, TOPIC_HZ = 200, 10
WHEELS, WHEEL_HZ = 4, 500

Messages = Sequence[RawMessage]


def evenly(sample: Messages, topic: str, msgtype: str, fields: Any, *, count: int) -> Iterator[RawMessage]:
    """Messages of one content over the time of a sample."""
    from builders import raw

    start_ns, end_ns = sample[0].log_time_ns, sample[-1].log_time_ns
    first = raw(topic, msgtype, fields, start_ns, encoding=sample[0].channel.encoding)  # type: ignore[arg-type]  # ROS
    for number in range(count):
        yield first._replace(log_time_ns=start_ns + (end_ns - start_ns) * number // count)


def many_topics(sample: Messages, seconds: float) -> list[Iterator[RawMessage]]:
    """Topics of single numbers."""
    count = round(seconds * TOPIC_HZ)
    return [evenly(sample, f"/value_{number}", "std_msgs/msg/Float64", {}, count=count) for number in range(TOPICS)]


def fast_cameras(sample: Messages, _: float) -> list[Iterator[RawMessage]]:
    """Images between those of the sample, whose stamps are as late as they are themselves."""
    by_topic: dict[str, list[RawMessage]] = {}
    for message in sample:
        if message.channel.msgtype in IMAGES:
            by_topic.setdefault(message.topic, []).append(message)
    return [_between(messages) for messages in by_topic.values()]


def _between(messages: Messages) -> Iterator[RawMessage]:
    for first, second in pairwise(messages):
        for part in range(1, IMAGE_TIMES):
            shift_ns = (second.log_time_ns - first.log_time_ns) * part // IMAGE_TIMES
            yield restamped(first, shift_ns)


def restamped(message: RawMessage, shift_ns: int) -> RawMessage:
    """A message as if measured and recorded later; its header begins the message."""
    sec, nanosec = divmod(message.stamp_ns + shift_ns, 10**9)
    stamp = sec.to_bytes(4, "little") + nanosec.to_bytes(4, "little")
    data = bytes(message.data)[:4] + stamp + bytes(message.data)[12:]  # behind seq, or the encapsulation
    return message._replace(log_time_ns=message.log_time_ns + shift_ns, stamp_ns=message.stamp_ns + shift_ns, data=data)


def cases(sample: Messages, tiny: int) -> dict[str, Callable[[], list[Iterator[RawMessage]]]]:
    """What each recording has beside the sample."""
    from builders import tf_message, transform_stamped

    seconds = (sample[-1].log_time_ns - sample[0].log_time_ns) / 1e9
    wheels = tf_message([transform_stamped("chassis", f"wheel_{n}", stamp_ns=0) for n in range(WHEELS)])
    return {
        "as it is": list,
        "200 topics": lambda: many_topics(sample, seconds),
        "fast cameras": lambda: fast_cameras(sample, seconds),
        "tiny": lambda: [evenly(sample, "/imu", "sensor_msgs/msg/Imu", {}, count=tiny)],
        "wheels": lambda: [
            evenly(sample, "/tf", "tf2_msgs/msg/TFMessage", wheels, count=round(seconds * WHEEL_HZ * WHEELS))
        ],
    }


def write(folder: Path, form: str, messages: Iterator[RawMessage]) -> Path:
    """Write a recording of one format."""
    from builders import write_mcap, write_rosbag1, write_rosbag2

    path = folder / f"{form}.{form.partition('-')[0]}"
    match form:
        case "mcap":
            write_mcap(path, messages, "zstd")
        case "db3":
            path = folder / form
            write_rosbag2(path, messages)
        case _:
            write_rosbag1(path, messages, "lz4" if form == "bag-lz4" else "none")
    return path


def open_only(path: Path) -> int:
    """Open a recording."""
    with open_recording([path]) as recording:
        return recording.message_count


def read_used(path: Path) -> int:
    """Read what a run reads of a recording, and look at nothing of it."""
    with opened(make_job(path)) as run:
        topics = synchronized_topics(run.source.config, run.source.rig)
        return sum(1 for _ in run.source.recording.messages(topics))


def inspect(path: Path) -> int:
    """What `lidcam inspect` does."""
    return inspect_recording([path], choose_settings(None)).messages


def process(path: Path) -> int:
    """What `lidcam process` does with one worker."""
    with tempfile.TemporaryDirectory() as folder:
        return process_recording(make_job(path, Path(folder) / "out.mcap", workers=1)).frames.count


WORK: dict[str, Callable[[Path], int]] = {"open": open_only, "read": read_used, "inspect": inspect, "process": process}


def measured(paths: dict[str, Path], rounds: int) -> dict[tuple[str, str], float]:
    """Least seconds of processor time by case and work."""
    found: dict[tuple[str, str], float] = {}
    for _ in range(rounds):
        for case, path in paths.items():
            for name, work in WORK.items():
                started = time.process_time()
                work(path)
                seconds = time.process_time() - started
                found[case, name] = min(found.get((case, name), seconds), seconds)
    return found


def main() -> None:
    """Measure and print."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--tiny", type=int, default=1_000_000)
    parser.add_argument("--formats", nargs="*", choices=SAMPLES, default=[*SAMPLES])
    parser.add_argument("--cases", nargs="*", help="some of them")
    options = parser.parse_args()
    print(f"{'':22}{'messages':>10}" + "".join(f"{name:>22}" for name in WORK))
    for form in options.formats:
        with tempfile.TemporaryDirectory() as folder:
            with open_recording([ROOT / "bags" / SAMPLES[form]]) as recording:
                sample = [*recording.messages()]
            paths = {}
            for number, (case, more) in enumerate(cases(sample, options.tiny).items()):
                if case == "as it is" or not options.cases or case in options.cases:
                    (place := Path(folder) / str(number)).mkdir()
                    together = merge(sample, *more(), key=lambda message: message.log_time_ns)
                    paths[case] = write(place, form, together)
            found = measured(paths, options.rounds)
            for case, path in paths.items():
                line = f"{form + ' ' + case:22}{open_only(path):10}"
                for name in WORK:
                    ms, times = 1e3 * found[case, name], found[case, name] / found["as it is", name]
                    line += f"{ms:13.0f} ({times:5.1f})"
                print(line, flush=True)


if __name__ == "__main__":
    main()
