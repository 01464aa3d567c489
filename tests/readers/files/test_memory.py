"""Memory does not grow with a recording, and a sound file that is read with too little of it is not called damaged."""

import tracemalloc
from pathlib import Path
from typing import Any, Literal
from unittest.mock import Mock

import pytest
from builders import raw, write_recording

from lidcam.pipeline.core.errors import ShortMemoryError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions

MEGABYTE = 1 << 20


def blobs(n: int, encoding: Literal["ros1", "cdr"]) -> list[RawMessage]:
    message = raw("/cloud", "sensor_msgs/msg/PointCloud2", {"data": bytes(200_000)}, 0, encoding=encoding)
    return [message._replace(log_time_ns=i) for i in range(n)]


@pytest.mark.parametrize("kind", ["bag-none", "bag-lz4", "sqlite", "mcap-none", "mcap-zstd", "loose"])
def test_memory_does_not_grow_with_the_recording(tmp_path: Path, kind: str) -> None:
    """8 MB and 40 MB of messages: neither is ever in memory as a whole."""
    peaks = []
    for n in (40, 200):
        messages = blobs(n, "ros1" if kind.startswith("bag") else "cdr")
        path = write_recording(tmp_path / f"{kind}{n}", kind, messages)
        tracemalloc.start()
        with open_recording([path]) as recording:
            assert sum(len(m.data) for m in recording.messages()) > n * 200_000
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert max(peaks) < 6 * MEGABYTE, peaks
    assert peaks[1] < peaks[0] + MEGABYTE / 4, peaks


@pytest.mark.parametrize("recovery", ["none", "as_needed", "full_scan"])
@pytest.mark.parametrize(
    ("kind", "place"),
    [
        ("mcap-zstd", "lidcam.readers.files.mcap.records.zstandard.decompress"),
        ("bag-lz4", "lidcam.readers.files.rosbag1.rosbag1_file.unpack"),
        ("sqlite", "lidcam.readers.files.sqlite_file.decompressed"),
    ],
)
def test_of_every_container(
    tmp_path: Path, kind: str, place: str, recovery: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_recording(tmp_path / "a", kind, blobs(3, "ros1" if kind == "bag-lz4" else "cdr"))
    monkeypatch.setattr(place, Mock(side_effect=MemoryError))
    with (
        pytest.raises(ShortMemoryError, match="not enough memory to read "),
        open_recording([path], ReadOptions(recovery)) as recording,
    ):
        list(recording.messages())


def test_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    (message,) = blobs(1, "cdr")
    monkeypatch.setattr("rosbags.typesys.store.Typestore.deserialize_cdr", Mock(side_effect=MemoryError))
    with pytest.raises(MemoryError):
        deserialize(message)
