"""A sound file that is read with too little memory is not called damaged."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from builders import pointcloud2, raw, write_mcap, write_rosbag1, write_rosbag2

from lidcam.pipeline.core.errors import MessageError, ShortMemoryError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions

ROOT = Path(__file__).resolve().parents[3]
CLOUD = "sensor_msgs/msg/PointCloud2"


def clouds(encoding: Any = "cdr", count: int = 3, size: int = 1000) -> list[RawMessage]:
    bodies = ({**pointcloud2([[1, 2, 3]], stamp_ns=i), "data": bytes(size)} for i in range(1, count + 1))
    return [raw("/a", CLOUD, body, i, encoding=encoding) for i, body in enumerate(bodies, 1)]


def none_left(*_: Any, **__: Any) -> Any:
    raise MemoryError


@pytest.mark.parametrize("recovery", ["none", "as_needed", "full_scan"])
@pytest.mark.parametrize(
    ("kind", "place"),
    [
        ("mcap", "lidcam.readers.files.mcap.records.zstandard.decompress"),
        ("bag", "lidcam.readers.files.rosbag1.rosbag1_file.unpack"),
        ("sqlite", "lidcam.readers.files.sqlite.sqlite_file.decompressed"),
    ],
)
def test_of_every_container(
    tmp_path: Path, kind: str, place: str, recovery: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "mcap":
        write_mcap(path := tmp_path / "a.mcap", clouds(), "zstd")
    elif kind == "bag":
        write_rosbag1(path := tmp_path / "a.bag", clouds("ros1"), "lz4")
    else:
        write_rosbag2(path := tmp_path / "a", clouds())
    monkeypatch.setattr(place, none_left)
    with (
        pytest.raises(ShortMemoryError, match="not enough memory to read "),
        open_recording([path], ReadOptions(recovery)) as recording,
    ):
        list(recording.messages())


def test_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    (message,) = clouds(count=1)
    monkeypatch.setattr("rosbags.typesys.store.Typestore.deserialize_cdr", none_left)
    with pytest.raises(MemoryError):
        deserialize(message)
    with pytest.raises(MessageError):
        deserialize(message._replace(problem="damaged"))


CHILD = """
import resource, sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from lidcam.readers.open import open_recording
from lidcam.pipeline.core.errors import ShortMemoryError
with open_recording([Path(sys.argv[1])]) as recording:
    messages = recording.messages()
    next(messages)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + (64 << 20), resource.RLIM_INFINITY))
    try:
        print("read", sum(1 for _ in messages))
    except ShortMemoryError as err:
        print(err, recording.losses)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="no limit of the address space")
def test_with_a_limit_of_the_system(tmp_path: Path) -> None:
    small, large = clouds(count=2), clouds(count=1, size=200 << 20)[0]._replace(log_time_ns=9)
    write_mcap(tmp_path / "a.mcap", [*small, large], "zstd", chunk_bytes=1 << 10)
    done = subprocess.run(
        [sys.executable, "-c", CHILD, tmp_path / "a.mcap", ROOT], capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith(f"not enough memory to read {tmp_path / 'a.mcap'}"), done.stderr
    assert done.stdout.rstrip().endswith("()")
