"""One message that is cut, or whose stamp cannot be a time: counted under its topic, or the end of the run."""

import json
from pathlib import Path

import pytest
from builders import write_rosbag1
from command import Lidcam
from small_drive import small_drive

FRAMES = 6


def recording(path: Path, *, bad: str, stamp: bytes = b"") -> Path:
    """A lidar, a camera and odometry: a message of `bad` is cut in half, or its last one has another stamp."""
    messages = small_drive("ros1", frames=FRAMES)
    rows = [row for row, message in enumerate(messages) if message.topic == bad]
    row = rows[-1] if stamp else rows[len(rows) // 2]
    data = bytes(messages[row].data)
    altered = data[:4] + stamp + data[12:] if stamp else data[: len(data) // 2]
    messages[row] = messages[row]._replace(data=altered)
    write_rosbag1(path, messages)
    return path


@pytest.mark.parametrize("bad", ["/odom", "/cam/image_raw", "/points", "/tf_static"])
def test_it_is_counted_or_ends_the_run(lidcam: Lidcam, tmp_path: Path, bad: str) -> None:
    run = lidcam("process", recording(tmp_path / "a.bag", bad=bad), tmp_path / "out.mcap", "--json")
    assert run.code == 3, run.err
    report = json.loads(run.out)
    (drop,) = (drop for drop in report["drops"] if drop["topic"] == bad)
    assert (drop["count"], drop["reason"] != "", report["exit_code"]) == (1, True, 3)
    assert run.err.splitlines()[-1].startswith("lidcam: incomplete: ")
    inspected = lidcam("inspect", tmp_path / "a.bag")
    assert inspected.code == (3 if bad == "/tf_static" else 0)  # it decodes what it needs for the calibration only
    verdict = "cam (/cam/image_raw) is left out" if bad == "/tf_static" else "sound, and all of its sensors can be used"
    assert inspected.out.splitlines()[-1] == f"verdict: {verdict}"
    run = lidcam("process", tmp_path / "a.bag", tmp_path / "other.mcap", "--on-bad-message", "fail")
    assert run.code == 1
    assert bad in run.error_line
    assert not list(tmp_path.glob("other*"))


@pytest.mark.parametrize(
    ("topic", "stamp"),
    [
        ("/points", b"\xff" * 8),
        ("/cam/image_raw", b"\0\0\0\x80" + bytes(4)),
        ("/odom", b"\xff\xff\xff\x7f" + b"\xff" * 4),
    ],
)
def test_a_stamp_that_cannot_be_a_time(lidcam: Lidcam, tmp_path: Path, topic: str, stamp: bytes) -> None:
    """It is that of the last message, which no later one shows to be wrong; all other frames are written."""
    path = recording(tmp_path / "a.bag", bad=topic, stamp=stamp)
    run = lidcam("process", path, tmp_path / "out.mcap", "--json")
    assert run.code in {0, 3}, run.err
    report = json.loads(run.out)
    assert report["frames"] == FRAMES - (topic == "/points")
    counts = {drop["reason"]: drop["count"] for drop in report["drops"] if drop["topic"] == topic}
    assert counts == {"its stamp cannot be a time": 1}
    run = lidcam("process", path, tmp_path / "other.mcap", "--on-bad-message", "fail")
    assert run.code == 1
    assert f"{topic}: stamp " in run.error_line
