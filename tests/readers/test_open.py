import bz2
import gzip
import lzma
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from builders import header, image, odometry, raw, write_mcap, write_recording
from helpers import shared
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.recording import DEFAULT_READ_OPTIONS, ReadOptions

T0 = 1_700_000_000 * 10**9
ODOMETRY = "nav_msgs/msg/Odometry"


def drive(encoding: Literal["ros1", "cdr"], n: int = 12) -> list[RawMessage]:
    """Odometry at 100 Hz and an image with every third, recorded 2 ms late; equal log times every third."""
    messages = []
    for i in range(n):
        stamp = T0 + i * 10**7
        messages.append(raw("/odom", ODOMETRY, odometry(stamp_ns=stamp), stamp, stamp + 2_000_000, encoding))
        if i % 3 == 0:
            pixels = np.full((4, 6, 3), i, np.uint8)
            message = image(pixels, stamp_ns=stamp - 5)
            messages.append(raw("/image", "sensor_msgs/msg/Image", message, stamp - 5, stamp + 2_000_000, encoding))
    return messages


def plain(messages: Sequence[RawMessage]) -> list[tuple[str, int, int, bytes]]:
    return [(m.topic, m.stamp_ns, m.log_time_ns, bytes(m.data)) for m in messages]


def read(
    *paths: Path,
    topics: Sequence[str] | None = None,
    start_ns: int | None = None,
    stop_ns: int | None = None,
    options: ReadOptions = DEFAULT_READ_OPTIONS,
) -> list[RawMessage]:
    with open_recording(paths, options) as recording:
        return list(recording.messages(topics, start_ns=start_ns, stop_ns=stop_ns))


def write(folder: Path, kind: str, messages: Sequence[RawMessage], name: str = "rec") -> Path:
    ending = ".bag" if kind.startswith("bag") else "" if kind.startswith("folder") else ".mcap"
    return write_recording(folder / f"{name}{ending}", kind, messages, chunk_bytes=2000)


ROS1_KINDS = ["bag-none", "bag-bz2", "bag-lz4", "mcap-lz4"]
ROS2_KINDS = ["mcap-none", "mcap-lz4", "mcap-zstd", "loose"]
ROS2_KINDS += [f"folder:sqlite3-{compressed}" for compressed in ("none", "message", "file")]
ROS2_KINDS += [f"folder:mcap-{compressed}" for compressed in ("none", "storage", "message", "file")]
KINDS = [*((kind, "ros1") for kind in ROS1_KINDS), *((kind, "cdr") for kind in ROS2_KINDS)]
KINDS_OF_INDEX = [
    (kind, encoding)
    for kind, encoding in KINDS
    if kind in {"bag-lz4", "mcap-zstd", "loose", "folder:sqlite3-none", "folder:mcap-message", "folder:mcap-file"}
]
"""One of each way in which a window is found."""


@pytest.mark.parametrize(("kind", "encoding"), KINDS)
def test_every_container_gives_the_messages_back(tmp_path: Path, kind: str, encoding: Literal["ros1", "cdr"]) -> None:
    messages = drive(encoding)
    with open_recording([write(tmp_path, kind, messages)]) as recording:
        got = list(recording.messages())
        assert plain(got) == plain(messages)
        assert [m.order for m in got] == sorted({m.order for m in got})
        assert recording.message_count == len(messages)
        assert (recording.start_ns, recording.end_ns) == (messages[0].log_time_ns, messages[-1].log_time_ns)
        assert [(t.topic, t.msgtype, t.message_count, t.unreadable) for t in recording.topics] == [
            ("/image", "sensor_msgs/msg/Image", 4, ""),
            ("/odom", ODOMETRY, 12, ""),
        ]
        assert recording.topics[1].channel.encoding == encoding
    assert [deserialize(m).header.frame_id for m in got[:2]] == ["odom", "camera"]


@pytest.mark.parametrize(("kind", "encoding"), KINDS_OF_INDEX)
def test_window_and_topics(tmp_path: Path, kind: str, encoding: Literal["ros1", "cdr"]) -> None:
    messages = drive(encoding)
    path = write(tmp_path, kind, messages)
    first, last = messages[3].log_time_ns, messages[9].log_time_ns
    inside = [m for m in messages if first <= m.log_time_ns < last]
    assert plain(read(path, start_ns=first, stop_ns=last)) == plain(inside)
    images = [m for m in inside if m.topic == "/image"]
    assert plain(read(path, topics=["/image", "/nothing"], start_ns=first, stop_ns=last)) == plain(images)
    assert read(path, topics=[]) == []
    assert read(path, start_ns=last, stop_ns=first) == []
    assert read(path, stop_ns=T0) == []


@pytest.mark.parametrize("kind", [kind for kind, _ in KINDS_OF_INDEX])
def test_a_recording_without_messages_opens(tmp_path: Path, kind: str) -> None:
    with open_recording([write(tmp_path, kind, [])]) as recording:
        assert list(recording.messages()) == []
        assert (recording.message_count, recording.start_ns, recording.end_ns, recording.topics) == (0, 0, 0, ())


@settings(max_examples=25)
@given(
    offsets=st.lists(st.integers(0, 5), min_size=1, max_size=12),
    cuts=st.sets(st.integers(0, 12), max_size=3),
    kind=st.sampled_from(["bag-none", "bag-lz4", "mcap-zstd", "loose", "folder:sqlite3-none"]),
)
def test_splitting_a_recording_changes_nothing(
    tmp_path_factory: pytest.TempPathFactory, offsets: list[int], cuts: set[int], kind: str
) -> None:
    folder = tmp_path_factory.mktemp("split")
    encoding: Literal["ros1", "cdr"] = "ros1" if kind.startswith("bag") else "cdr"
    messages = [  # log times in any order, many equal; stamps tell the messages apart
        raw(f"/t{i % 3}", ODOMETRY, odometry(stamp_ns=T0 + i), T0 + i, T0 + offset, encoding)
        for i, offset in enumerate(offsets)
    ]
    bounds = [0, *sorted(cut for cut in cuts if cut < len(messages)), len(messages)]
    parts = [write(folder, kind, messages[first:last], f"part{i}") for i, (first, last) in enumerate(pairwise(bounds))]
    expected = plain(sorted(messages, key=lambda m: m.log_time_ns))  # stable: equal times in writing order
    assert plain(read(write(folder, kind, messages, "whole"))) == expected
    assert plain(read(*parts)) == expected


def test_one_topic_with_two_definitions(tmp_path: Path) -> None:
    old = raw("/state", "std_msgs/msg/Header", header(T0, "a"), T0)
    path = tmp_path / "two.mcap"
    write_mcap(path, [old, raw("/state", ODOMETRY, odometry(stamp_ns=T0 + 1), T0 + 1)])
    with open_recording([path]) as recording:
        assert [(t.topic, t.msgtype, t.message_count) for t in recording.topics] == [
            ("/state", ODOMETRY, 1),
            ("/state", "std_msgs/msg/Header", 1),
        ]
        assert [m.stamp_ns for m in recording.messages(["/state"])] == [T0, T0 + 1]


def test_messages_stay_valid_after_closing_and_reading_then_fails(tmp_path: Path) -> None:
    messages = drive("ros1")
    with open_recording([write(tmp_path, "bag-lz4", messages)]) as recording:
        kept = list(recording.messages())
    assert plain(kept) == plain(messages)
    with pytest.raises(RecordingError, match="was closed"):
        next(recording.messages())


# --- what is no recording


def put(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def open_files() -> int:
    """Number of this process's open files; 0 where the system does not tell."""
    folder = Path("/proc/self/fd")
    return len([*folder.iterdir()]) if folder.exists() else 0


def assert_refused(paths: Sequence[Path], *parts: str) -> None:
    before = open_files()
    with pytest.raises(RecordingError) as caught:
        open_recording(paths)
    message = str(caught.value)
    assert "\n" not in message
    assert all(part in message for part in parts), message
    assert open_files() == before, "a file stayed open"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("empty.bag", b"", "an empty file"),
        ("notes.txt", b"lidar on the left pole\n", "a text file"),
        ("image.bin", b"\x00\x01\x02", "a file of another kind"),
        ("text.bag", b"lidar on the left pole\n", "a file that does not begin as a .bag file"),
        (
            "drive.mcap",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n",
            "a Git LFS pointer in its place; fetch it with `git lfs pull`",
        ),
        ("drive.bag.gz", gzip.compress(b"#ROSBAG V2.0\n", mtime=0), "gzip; unpack it with `gunzip --keep`"),
        ("drive.bag.bz2", bz2.compress(b"#ROSBAG V2.0\n"), "bzip2; unpack it with `bunzip2 --keep`"),
        ("drive.bag.xz", lzma.compress(b"#ROSBAG V2.0\n"), "xz; unpack it with `unxz --keep`"),
        (
            "drive.tar",
            b"drive/drive.mcap".ljust(257, b"\0") + b"ustar\x0000",
            "a tar archive; unpack it with `tar -xf`",
        ),
        ("drive.zip", b"PK\3\4\x14\0", "a zip archive; unpack it"),
        ("out.rrd", b"RRF2\0\1\0\0", "a Rerun recording, which is for viewing"),
        ("drive.osf", b"\x34\0\0\0\x14\0\0\0OSF$\x0c", "an Ouster recording (OSF); save it as a .pcap"),
        ("old.bag", b"#ROSBAG V1.2\n" + b"\0" * 50, "format 1.2; convert it"),
        ("magic.bag", b"#ROSBAG V2.0\n", "damaged or was not closed"),
        ("magic.mcap", b"\x89MCAP0\r\n", "damaged or was not closed"),
        ("magic.db3", b"SQLite format 3\0", "damaged or was not closed"),
        ("magic.db3.zstd", b"\x28\xb5\x2f\xfd", "a compressed file with nothing in it"),
    ],
)
def test_files_that_are_no_recording(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    assert_refused([put(tmp_path / name, content)], name, says)


def test_paths_without_a_recording(tmp_path: Path) -> None:
    assert_refused([], "got no path")
    assert_refused([tmp_path / "nope.bag"], "no such file or folder", ".mcap")
    assert_refused([tmp_path / (300 * "x")], "cannot be read: File name too long")
    assert_refused([tmp_path], "expected a ROS 2 bag folder", "found none")
    for folder, says in (
        ("training/velodyne", "frames of KITTI"),
        ("2011_09_26/velodyne_points", "`kitti2mcap`"),
        ("samples/LIDAR_TOP", "nuscenes2mcap"),
    ):
        (tmp_path / folder / "data").mkdir(parents=True)
        for path in (tmp_path, tmp_path.parent, tmp_path / folder / "data"):
            assert_refused([path], "expected a ROS 2 bag folder", says)


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "drive.bag")
    with pytest.raises(RecordingError, match=r"drive.bag: neither a file nor a folder; expected a ROS 1 .bag"):
        open_recording([tmp_path / "drive.bag"])


def test_recordings_that_do_not_go_together(tmp_path: Path) -> None:
    bag = write(tmp_path, "bag-none", drive("ros1"))
    assert_refused([tmp_path], "found 1 ROS 1 .bag file(s)", "one by one")
    folder = write(tmp_path, "folder:sqlite3-none", drive("cdr"))
    assert_refused([bag, folder], "ROS 1", "ROS 2", "one by one")


def test_the_same_file_twice(tmp_path: Path) -> None:
    folder = write(tmp_path, "folder:mcap-none", drive("cdr"))
    assert_refused([folder, folder / "rec.mcap"], "given twice")
    link = tmp_path / "link.mcap"
    link.symlink_to(folder / "rec.mcap")
    for other in (link, folder / "rec.mcap"):
        assert_refused([folder / "rec.mcap", other], "given twice")


def test_two_recordings_of_the_same_time(tmp_path: Path) -> None:
    """Parts may overlap by what was on its way when one ended, and by any time where they hold other sensors."""

    def part(name: str, start_s: float, topic: str = "/image") -> Path:
        path, first_ns = tmp_path / f"{name}.mcap", T0 + round(start_s * 1e9)
        stamps_ns = range(first_ns, first_ns + 2 * 10**9 + 1, 10**8)
        pixels = np.zeros((4, 6, 3), np.uint8)
        write_mcap(path, [raw(topic, "sensor_msgs/msg/Image", image(pixels, stamp_ns=at), at) for at in stamps_ns])
        return path

    first = part("first", 0.0)
    assert_refused([first, part("again", 0.3)], "first.mcap", "again.mcap both hold /image over the same 1.7 s")
    for other in (part("next", 1.6), part("other", 0.3, topic="/other"), part("later", 90.0)):
        with open_recording([first, other]) as recording:
            assert recording.message_count == 42


# --- real recordings


def test_real_recording_in_three_compressions() -> None:
    folder = shared("data/reader_fixtures/foxglove_rosbag")
    contents = [plain(read(folder / name)) for name in ("example.bag", "example-bz2.bag", "example-lz4.bag")]
    assert contents[0] == contents[1] == contents[2]
    assert len(contents[0]) == 8647
    with open_recording([folder / "no-messages.bag"]) as recording:
        assert recording.message_count == 0
    assert_refused([folder / "asci-file.txt"], "a text file")
    assert_refused([folder / "empty-file.bag"], "an empty file")
