"""One message that is cut: counted under its topic, or the end of the run."""

import json
from pathlib import Path

import pytest
from builders import write_rosbag1
from command import Lidcam
from helpers import CLUSTERS
from small_drive import small_drive


def recording(path: Path, *, bad: str) -> Path:
    """A lidar, a camera and odometry: a message of `bad` is cut in half."""
    messages = small_drive("ros1", frames=6)
    rows = [row for row, message in enumerate(messages) if message.topic == bad]
    row = rows[len(rows) // 2]
    data = bytes(messages[row].data)
    messages[row] = messages[row]._replace(data=data[: len(data) // 2])
    write_rosbag1(path, messages)
    return path


@pytest.mark.parametrize("bad", ["/cam/image_raw", "/tf_static"])
def test_it_is_counted_or_ends_the_run(lidcam: Lidcam, tmp_path: Path, bad: str) -> None:
    run = lidcam("process", recording(tmp_path / "a.bag", bad=bad), tmp_path / "out.mcap", "--json", "--set", CLUSTERS)
    assert run.code == 3, run.err
    report = json.loads(run.out)
    (drop,) = (drop for drop in report["drops"] if drop["topic"] == bad)
    assert (drop["count"], drop["reason"] != "", report["exit_code"]) == (1, True, 3)
    assert run.err.splitlines()[-1].startswith("lidcam: incomplete: ")
    inspected = lidcam("inspect", tmp_path / "a.bag")
    assert inspected.code == (3 if bad == "/tf_static" else 0)  # it decodes what it needs for the calibration only
    verdict = "cam (/cam/image_raw) is left out" if bad == "/tf_static" else "sound, and all of its sensors can be used"
    assert f"verdict: {verdict}" in inspected.out.splitlines()
    run = lidcam("process", tmp_path / "a.bag", tmp_path / "other.mcap", "--on-bad-message", "fail")
    assert run.code == 1
    assert bad in run.error_line
    assert not list(tmp_path.glob("other*"))
