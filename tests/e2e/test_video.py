"""The sample recording with its cameras as video: the same fused objects, and images to look at."""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import cv2
import pytest
from builders import in_order, write_rosbag1
from command import Lidcam
from helpers import CLUSTERS
from results import fused_objects, messages_of, stamp_of, topics_of
from video import compressed_video, encode, psnr_db

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.image import decode_any_image

pytestmark = pytest.mark.slow

GOP = 3
NUMBERS = (11, 12, 13, 14, 41, 42, 43, 44)
IMAGE_TOPICS = [f"/image_raw_{number}/compressed" for number in NUMBERS]
FIRST = IMAGE_TOPICS[0]
OUTPUT_TOPICS = [f"/cam{number}/image/compressed" for number in NUMBERS]

Sensors = dict[str, list[RawMessage]]


@pytest.fixture(scope="module")
def filmed(first_messages: Sensors) -> Sensors:
    """The cameras as CompressedVideo of ROS 1: stamps, frames and log times of the images."""
    films = {}
    for topic in IMAGE_TOPICS:
        images = [decode_any_image(message) for message in first_messages[topic]]
        packets = encode([image.rgb for image in images], gop=GOP, crf="12")
        films[topic] = [
            video(packet.data, message, frame_id=image.frame_id)
            for packet, message, image in zip(packets, first_messages[topic], images, strict=True)
        ]
    return first_messages | films


def video(data: bytes, like: RawMessage, frame_id: str = "camera") -> RawMessage:
    """A packet in the place of another message."""
    return compressed_video(data, like.stamp_ns, like.log_time_ns, topic=like.topic, encoding="ros1", frame_id=frame_id)


Process = Callable[..., tuple[int, Any, str]]


@pytest.fixture(scope="module")
def process(lidcam: Lidcam) -> Process:
    def run(path: Path, out: Path, *options: object) -> tuple[int, Any, str]:
        done = lidcam("process", path, out, "--config", "sandbox", "--set", CLUSTERS, "--json", *options)
        return done.code, json.loads(done.out) if done.code in {0, 3} else None, done.err

    return run


@pytest.fixture(scope="module")
def film(filmed: Sensors, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "film.bag"
    write_rosbag1(path, in_order(*filmed.values()))
    return path


@pytest.fixture(scope="module")
def whole(process: Process, film: Path) -> Path:
    """What becomes of the film, stage after stage."""
    code, _, err = process(film, out := film.with_suffix(".out.mcap"), "--workers", 1)
    assert code == 0, err
    return out


def assert_alike(out: Path, expected: Path, *, without_ns: Collection[int] = ()) -> None:
    """The images of the first camera are there and look as they should, but for those of some stamps."""
    one, other = (images_of(path) for path in (out, expected))
    assert one.keys() == other.keys() - set(without_ns)
    assert one
    assert all(psnr_db(image, other[stamp_ns]) > 32 for stamp_ns, image in one.items())


def images_of(out: Path) -> dict[int, Any]:
    found = {}
    for _, message in messages_of(out, OUTPUT_TOPICS[0]):
        assert (message.format, message.header.frame_id) == ("jpeg", "camera_11_optical")
        found[stamp_of(message)] = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
    return found


def test_the_same_objects_and_bytes(
    process: Process, film: Path, whole: Path, first_result: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.mcap"
    code, report, err = process(film, out, "--workers", 4, "--rerun", tmp_path / "out.rrd")
    assert code == 0, err
    assert out.read_bytes() == whole.read_bytes()
    command = [sys.executable, "-m", "rerun_cli", "rrd", "print", "-v", str(tmp_path / "out.rrd")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    packets = [int(n) for n in re.findall(r"with (\d+) rows .* - /world/cameras/cam11/image .*VideoStream", printed)]
    assert sum(packets) == len(images_of(out))  # one packet per frame, as it came
    assert not any("decoded" in drop["reason"] or "shown" in drop["reason"] for drop in report["drops"])
    assert fused_objects(whole) == fused_objects(first_result)
    assert topics_of(whole)[OUTPUT_TOPICS[0]][0] == "sensor_msgs/msg/CompressedImage"
    assert_alike(whole, first_result)


def test_a_broken_packet(process: Process, filmed: Sensors, first_result: Path, tmp_path: Path) -> None:
    """Images of its camera are missing up to the next key frame, the objects are not."""
    first = list(filmed[FIRST])
    first[1] = video(b"\0\0\0\1\x41" + b"nonsense" * 9, first[1])
    path, out = tmp_path / "broken.bag", tmp_path / "out.mcap"
    write_rosbag1(path, in_order(*(filmed | {FIRST: first}).values()))
    code, report, err = process(path, out)
    assert code == 3, err
    drops = {drop["reason"]: drop["count"] for drop in report["drops"] if drop["topic"] == FIRST}
    assert drops["cannot be decoded"] == 1
    assert drops["after a packet that cannot be decoded, before the next key frame of the video"] == 1
    assert fused_objects(out).keys() == fused_objects(first_result).keys()
    assert_alike(out, first_result, without_ns=[one.stamp_ns for one in first[1:GOP]])
    code, _, err = process(path, tmp_path / "no.mcap", "--on-bad-message", "fail")
    assert (code, (tmp_path / "no.mcap").exists()) == (1, False)
    assert "this one is broken" in err
