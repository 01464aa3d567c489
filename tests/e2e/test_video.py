"""The sample recording with its cameras as video: the same fused objects, and images to look at."""

import json
import logging
from collections import defaultdict
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from builders import header, write_mcap, write_rosbag1
from command import Lidcam
from foxglove_messages import twin
from results import Found, fused_objects, messages_of, topics_of
from video import compressed_video, encode, ffmpeg_packet, psnr_db

from lidcam.commands.process import run_process
from lidcam.job import make_job
from pipeline.core.errors import IncompleteError
from pipeline.core.messages import RawMessage
from readers.messages.deserialize import deserialize
from readers.messages.image import decode_any_image
from readers.open import open_recording

FRAMES = 6
GOP = 3
NUMBERS = (11, 12, 13, 14, 41, 42, 43, 44)
IMAGE_TOPICS = [f"/image_raw_{number}/compressed" for number in NUMBERS]
FIRST = IMAGE_TOPICS[0]
OUTPUT_TOPIC = "/cam11/image/compressed"

Sensors = dict[str, list[RawMessage]]
Objects = dict[int, list[Found]]


@pytest.fixture(scope="module")
def sensors(sandbox: Path) -> Sensors:
    """The first messages of each topic: as many of each sensor."""
    by_topic: defaultdict[str, list[RawMessage]] = defaultdict(list)
    with open_recording([sandbox]) as recording:
        for info in recording.topics:
            if "base_pose" not in info.topic:
                by_topic[info.topic] += islice(recording.messages([info.topic]), FRAMES)
    return by_topic


@pytest.fixture(scope="module")
def filmed(sensors: Sensors) -> Sensors:
    """The same with the cameras as CompressedVideo of ROS 1: stamps, frames and log times of the images."""
    films = {}
    for topic in IMAGE_TOPICS:
        images = [decode_any_image(message) for message in sensors[topic]]
        packets = encode([image.rgb for image in images], gop=GOP, crf="12")
        films[topic] = [
            compressed_video(
                packet.data,
                message.stamp_ns,
                message.log_time_ns,
                topic=topic,
                encoding="ros1",
                frame_id=image.frame_id,
            )
            for packet, message, image in zip(packets, sensors[topic], images, strict=True)
        ]
    return sensors | films


@pytest.fixture(scope="module")
def expected(
    sensors: Sensors, lidcam: Lidcam, sandbox_config: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Objects, dict[int, Any]]:
    path = tmp_path_factory.mktemp("images") / "images.bag"
    write_rosbag1(path, in_order(sensors))
    return run(lidcam, path, sandbox_config)


@pytest.fixture(scope="module")
def film(filmed: Sensors, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "film.bag"
    write_rosbag1(path, in_order(filmed))
    return path


@pytest.fixture(scope="module")
def whole(lidcam: Lidcam, film: Path, sandbox_config: Path) -> Path:
    """What becomes of the film, stage after stage."""
    out = film.with_suffix(".out.mcap")
    done = lidcam("process", film, out, "--config", sandbox_config, "--workers", 1)
    assert done.code == 0, done.err
    return out


def in_order(sensors: Sensors) -> list[RawMessage]:
    messages: Iterable[RawMessage] = (message for topic in sensors.values() for message in topic)
    return sorted(messages, key=lambda message: (message.log_time_ns, message.topic))


def run(lidcam: Lidcam, path: Path, config: Path, *options: object) -> tuple[Objects, dict[int, Any]]:
    """Objects, and images of the first camera, by stamp."""
    out = path.with_suffix(".out.mcap")
    done = lidcam("process", path, out, "--config", config, *options)
    assert done.code == 0, done.err
    return fused_objects(out), images_of(out)


def images_of(out: Path) -> dict[int, Any]:
    found = {}
    for _, message in messages_of(out, OUTPUT_TOPIC):
        assert (message.format, message.header.frame_id) == ("jpeg", "camera_11_optical")
        image = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
        assert image is not None
        found[message.header.stamp.sec * 10**9 + message.header.stamp.nanosec] = image
    return found


def assert_alike(found: dict[int, Any], expected: dict[int, Any], *, least_db: float = 32) -> None:
    assert found.keys() == expected.keys()
    assert found
    for stamp_ns, image in found.items():
        assert psnr_db(image, expected[stamp_ns]) > least_db


def test_the_same_objects_and_bytes(
    lidcam: Lidcam,
    film: Path,
    whole: Path,
    expected: tuple[Objects, dict[int, Any]],
    sandbox_config: Path,
    tmp_path: Path,
) -> None:
    out, rerun = tmp_path / "out.mcap", tmp_path / "out.rrd"
    done = lidcam("process", film, out, "--config", sandbox_config, "--workers", 4, "--rerun", rerun, "--json")
    assert done.code == 0, done.err
    assert out.read_bytes() == whole.read_bytes()
    assert rerun.stat().st_size > 100_000
    assert not any("decoded" in drop["reason"] or "shown" in drop["reason"] for drop in json.loads(done.out)["drops"])
    assert fused_objects(whole) == expected[0]
    assert len(expected[0]) >= FRAMES - 1
    assert topics_of(whole)[OUTPUT_TOPIC][0] == "sensor_msgs/msg/CompressedImage"
    assert_alike(images_of(whole), expected[1])


@pytest.mark.parametrize("kind", ["protobuf", "ffmpeg"])
def test_other_messages_of_the_same_packets(
    lidcam: Lidcam, filmed: Sensors, whole: Path, sandbox_config: Path, tmp_path: Path, kind: str
) -> None:
    def other(message: RawMessage) -> RawMessage:
        if kind == "protobuf":
            return twin(message, "protobuf")
        recorded: Any = deserialize(message)
        return ffmpeg_packet(
            recorded.data.tobytes(),
            message.stamp_ns,
            message.log_time_ns,
            topic=message.topic.replace("compressed", "ffmpeg"),
            name="h264;yuv420p;bgr8;bgr8",
            header=header(message.stamp_ns, recorded.frame_id),
        )

    others = filmed | {topic: [other(message) for message in filmed[topic]] for topic in IMAGE_TOPICS}
    path, out = tmp_path / f"{kind}.mcap", tmp_path / "out.mcap"
    write_mcap(path, in_order(others), "zstd", profile="")
    done = lidcam("process", path, out, "--config", sandbox_config)
    assert done.code == 0, done.err
    for topic in ("/fused/detections", *(f"/cam{number}/image/compressed" for number in NUMBERS)):
        assert repr(messages_of(out, topic)) == repr(messages_of(whole, topic))


def test_a_window_begins_at_the_key_frame_before_it(
    lidcam: Lidcam, film: Path, whole: Path, filmed: Sensors, sandbox_config: Path, tmp_path: Path
) -> None:
    """The window begins one image behind the second key frame: the same images as from the beginning."""
    start_ns = min(filmed[topic][GOP + 1].log_time_ns for topic in IMAGE_TOPICS)
    with open_recording([film]) as recording:
        start_s = (start_ns - recording.start_ns) / 1e9
    out = tmp_path / "out.mcap"
    done = lidcam("process", film, out, "--config", sandbox_config, "--json", "--start", f"{start_s:.6f}")
    assert done.code == 0, done.err
    assert "key frame" not in done.out
    known, found = images_of(whole), images_of(out)
    assert 0 < len(found) < len(known)
    assert all(np.array_equal(image, known[stamp_ns]) for stamp_ns, image in found.items())


def test_what_comes_before_the_first_key_frame(
    lidcam: Lidcam, filmed: Sensors, expected: tuple[Objects, dict[int, Any]], sandbox_config: Path, tmp_path: Path
) -> None:
    """One camera was switched on between two key frames: its images are missing, the objects are not."""
    first, second = filmed[FIRST][:2]
    data = deserialize(second).data.tobytes()  # no key frame
    begun = compressed_video(data, first.stamp_ns, first.log_time_ns, topic=FIRST, encoding="ros1")
    late = filmed | {FIRST: [begun, *filmed[FIRST][1:]]}
    path = tmp_path / "late.bag"
    write_rosbag1(path, in_order(late))
    out = tmp_path / "out.mcap"
    done = lidcam("process", path, out, "--config", sandbox_config, "--json", "--on-bad-message", "fail")
    assert done.code == 0, done.err
    drops = [drop for drop in json.loads(done.out)["drops"] if drop["topic"] == FIRST]
    key_ns = filmed[FIRST][GOP].stamp_ns
    missing = sum(stamp_ns < key_ns for stamp_ns in expected[1])
    assert ("before the first key frame of the video", missing) in [(drop["reason"], drop["count"]) for drop in drops]
    assert missing
    assert fused_objects(out).keys() == expected[0].keys()
    assert_alike(images_of(out), {s: p for s, p in expected[1].items() if s >= key_ns})


@pytest.mark.parametrize("on_bad", ["skip", "fail"])
def test_a_broken_packet(
    lidcam: Lidcam,
    filmed: Sensors,
    expected: tuple[Objects, dict[int, Any]],
    sandbox_config: Path,
    tmp_path: Path,
    on_bad: str,
) -> None:
    broken = list(filmed[FIRST])
    broken[1] = compressed_video(
        b"\0\0\0\1\x41" + b"nonsense" * 9, broken[1].stamp_ns, broken[1].log_time_ns, topic=FIRST, encoding="ros1"
    )
    path, out = tmp_path / "broken.bag", tmp_path / "out.mcap"
    write_rosbag1(path, in_order(filmed | {FIRST: broken}))
    done = lidcam("process", path, out, "--config", sandbox_config, "--json", "--on-bad-message", on_bad)
    if on_bad == "fail":
        assert (done.code, out.exists()) == (1, False)
        assert "this one is broken" in done.error_line
        return
    assert done.code == 3, done.err
    drops = {drop["reason"]: drop["count"] for drop in json.loads(done.out)["drops"] if drop["topic"] == FIRST}
    assert drops["cannot be decoded"] == 1
    assert drops["after a packet that cannot be decoded, before the next key frame of the video"] == 1
    assert fused_objects(out).keys() == expected[0].keys()
    good = [broken[place].stamp_ns for place in (0, *range(GOP, FRAMES))]
    assert_alike(images_of(out), {s: p for s, p in expected[1].items() if s in good})


def test_inspect(lidcam: Lidcam, film: Path) -> None:
    done = lidcam("inspect", film, "--json")
    assert done.code == 0, done.err
    tree = json.loads(done.out)
    [topic] = [topic for topic in tree["topics"] if topic["topic"] == FIRST]
    assert topic["msgtype"] == "foxglove_msgs/msg/CompressedVideo"
    assert topic["rate_hz"] == pytest.approx(10, rel=0.05)
    assert sum(sensor["topic"] in IMAGE_TOPICS for sensor in tree["sensors"]) == len(NUMBERS)


def test_without_the_decoder(
    film: Path,
    expected: tuple[Objects, dict[int, Any]],
    sandbox_config: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each camera is left out with one line that says what to install; the lidars go on."""
    monkeypatch.setattr("readers.video.packets.find_spec", lambda _: None)
    out = tmp_path / "out.mcap"
    with caplog.at_level(logging.WARNING), pytest.raises(IncompleteError, match="is left out"):
        run_process(make_job(film, out, config=sandbox_config), as_json=True)
    warnings = [record.getMessage() for record in caplog.records if "video" in record.getMessage()]
    assert len(warnings) == len(NUMBERS)
    assert all("pip install 'lidcam[video]'" in warning for warning in warnings)
    assert fused_objects(out).keys() == expected[0].keys()
    assert OUTPUT_TOPIC not in topics_of(out)
    assert FIRST in capsys.readouterr().out
