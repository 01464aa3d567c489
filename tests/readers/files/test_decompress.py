import bz2
from io import BytesIO
from pathlib import Path
from typing import Literal

import lz4.frame
import pytest
from builders import odometry, raw, write_mcap, write_rosbag1

from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.files.chunked import detach
from lidcam.readers.files.decompress import unpack
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions


def packed(data: bytes, compression: str) -> bytes:
    frame: bytes = bz2.compress(data) if compression == "bz2" else lz4.frame.compress(data, content_checksum=True)
    return frame


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_frame_that_is_whole_cut_off_or_altered(compression: str) -> None:
    data = bytes(range(256)) * 5000
    frame = packed(data, compression)
    for size in (None, 0, len(data), 10**12):  # the size in the file may be wrong
        assert unpack(BytesIO(frame), 0, len(frame), compression, largest=1 << 21, size=size).data == data
    cut = unpack(BytesIO(frame), 0, len(frame) * 9 // 10, compression, largest=1 << 21, may_be_cut=True)
    assert data.startswith(cut.data)
    assert not cut.complete
    with pytest.raises(EOFError, match=f"its {compression} data end early"):
        unpack(BytesIO(frame), 0, len(frame) * 9 // 10, compression, largest=1 << 21)
    altered = bytearray(frame)
    altered[len(frame) // 2] ^= 1
    with pytest.raises((OSError, RuntimeError)):
        unpack(BytesIO(altered), 0, len(frame), compression, largest=1 << 21)


@pytest.mark.parametrize("kind", ["bz2", "lz4", "mcap-lz4", "mcap-zstd"])
def test_a_chunk_that_would_fill_the_memory_is_passed_over(tmp_path: Path, kind: Literal["bz2", "lz4"]) -> None:
    """Of three chunks, the second unpacks to more than is allowed."""
    form, _, how = kind.rpartition("-")
    encoding: Literal["ros1", "cdr"] = "cdr" if form else "ros1"
    state = "nav_msgs/msg/Odometry"
    messages = [
        raw("/odom", state, odometry(stamp_ns=i, frame_id="a" * (1_500_000 if i == 2 else 1)), i, i, encoding)
        for i in (1, 2, 3)
    ]
    path = tmp_path / ("rec.mcap" if form else "rec.bag")
    if form:
        write_mcap(path, messages, how, chunk_bytes=1)  # type: ignore[arg-type]  # a part of `kind`
    else:
        write_rosbag1(path, messages, kind, chunk_bytes=1)
    with open_recording([path], ReadOptions(limits=RecordingLimits(max_chunk_bytes=1 << 20))) as recording:
        assert [m.log_time_ns for m in recording.messages()] == [1, 3]
        (loss,) = recording.losses
    assert loss.messages == 1
    assert f"more than {1 << 20} bytes, see limit_scale" in loss.reason


# --- messages in chunks


@pytest.mark.parametrize(("start", "size"), [(0, 101), (100, 1), (0, -1)])
def test_messages_beyond_the_chunk(start: int, size: int) -> None:
    with pytest.raises(ValueError, match="beyond its chunk"):
        detach(bytes(100), start, size)
