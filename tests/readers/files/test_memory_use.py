import tracemalloc
from pathlib import Path
from typing import Any, Literal

import pytest
from builders import raw, write_mcap, write_rosbag1, write_rosbag2

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.open import open_recording

MEGABYTE = 1 << 20


def blobs(n: int, encoding: Literal["ros1", "cdr"]) -> list[RawMessage]:
    message = raw("/cloud", "sensor_msgs/msg/PointCloud2", {"data": bytes(200_000)}, 0, encoding=encoding)
    return [message._replace(log_time_ns=i) for i in range(n)]


def write(path: Path, kind: str, n: int) -> Path:
    compression: Any = kind.partition("-")[2]
    if kind.startswith("bag"):
        write_rosbag1(path, blobs(n, "ros1"), compression)
    elif kind.startswith("sqlite"):
        write_rosbag2(path, blobs(n, "cdr"))
    elif kind == "mcap-loose":
        write_mcap(path, blobs(n, "cdr"), use_chunking=False)
    else:
        write_mcap(path, blobs(n, "cdr"), compression)
    return path


@pytest.mark.parametrize("kind", ["bag-none", "bag-lz4", "sqlite", "mcap-none", "mcap-zstd", "mcap-loose"])
def test_memory_does_not_grow_with_the_recording(tmp_path: Path, kind: str) -> None:
    """8 MB and 40 MB of messages: neither is ever in memory as a whole."""
    peaks = []
    for n in (40, 200):
        path = write(tmp_path / f"{kind}{n}", kind, n)
        tracemalloc.start()
        with open_recording([path]) as recording:
            assert sum(len(m.data) for m in recording.messages()) > n * 200_000
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert max(peaks) < 6 * MEGABYTE, peaks
    assert peaks[1] < peaks[0] + MEGABYTE / 4, peaks
