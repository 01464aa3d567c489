"""The sample recording with its cameras as video: the same fused objects, and images to look at."""

import json
import re
import subprocess
import sys
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

OUTPUT_TOPIC = "/cam11/image/compressed"


def filmed(images: list[RawMessage]) -> list[RawMessage]:
    """The images of a camera as CompressedVideo of ROS 1, with their stamps, frames and log times."""
    shown, topic = [decode_any_image(message) for message in images], images[0].topic
    packets = encode([one.rgb for one in shown], gop=3, crf="12")
    return [
        compressed_video(
            packet.data, like.stamp_ns, like.log_time_ns, topic=topic, encoding="ros1", frame_id=one.frame_id
        )
        for packet, like, one in zip(packets, images, shown, strict=True)
    ]


def images_of(out: Path) -> dict[int, Any]:
    found = {}
    for _, message in messages_of(out, OUTPUT_TOPIC):
        assert (message.format, message.header.frame_id) == ("jpeg", "camera_11_optical")
        found[stamp_of(message)] = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
    return found


@pytest.mark.slow
def test_the_same_objects_and_bytes(
    lidcam: Lidcam, first_messages: dict[str, list[RawMessage]], first_result: Path, tmp_path: Path
) -> None:
    films = [filmed(all_) if "/image_raw" in topic else all_ for topic, all_ in first_messages.items()]
    write_rosbag1(tmp_path / "film.bag", in_order(*films))
    command = ("process", tmp_path / "film.bag", "--config", "sandbox", "--set", CLUSTERS, "--json")
    for workers in (4, 1):
        out = tmp_path / f"{workers}.mcap"
        done = lidcam(*command, "-o", out, "--workers", workers, "--rerun", tmp_path / "out.rrd")
        assert done.code == 0, done.err
        assert not any(re.search("decoded|shown", drop["reason"]) for drop in json.loads(done.out)["drops"])
    assert out.read_bytes() == (tmp_path / "4.mcap").read_bytes()
    listing = [sys.executable, "-m", "rerun_cli", "rrd", "print", "-v", str(tmp_path / "out.rrd")]
    printed = subprocess.run(listing, capture_output=True, text=True, check=True).stdout
    packets = [int(n) for n in re.findall(r"with (\d+) rows .* - /world/cameras/cam11/image .*VideoStream", printed)]
    assert fused_objects(out) == fused_objects(first_result)
    assert topics_of(out)[OUTPUT_TOPIC][0] == "sensor_msgs/msg/CompressedImage"
    found, expected = images_of(out), images_of(first_result)
    assert sum(packets) == len(found) > 0  # one packet per frame, as it came
    assert found.keys() == expected.keys()
    assert all(psnr_db(image, expected[stamp_ns]) > 32 for stamp_ns, image in found.items())
