"""A sound file that is read with too little memory is not called damaged."""

from pathlib import Path
from typing import Any

import pytest
from builders import pointcloud2, raw, write_mcap, write_rosbag1, write_rosbag2

from lidcam.pipeline.core.errors import MessageError, ShortMemoryError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions

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
