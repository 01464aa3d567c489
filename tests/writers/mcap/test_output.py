"""The library's writer is the judge: the same calls give the same bytes, but for the level of lz4."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import lz4.frame
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from lidcam.writers.mcap.chunk import LZ4_LEVEL, Compression
from lidcam.writers.mcap.output import CHUNK_BYTES, mcap_file
from lidcam.writers.outputs.marks import LIBRARY

SCHEMAS = [("a/msg/A", "ros2msg", b"int8 a"), ("b/msg/B", "ros2msg", b"")]
Messages = list[tuple[int, int, bytes]]
"""Channel from 1, log time, data."""


def by_library(path: Path, messages: Messages, compression: Compression) -> None:
    with path.open("xb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType[compression.upper()])
        writer.start(profile="ros2", library=LIBRARY)
        writer.add_metadata("first", {"key": "value", "ä": ""})
        writer.add_attachment(5, 5, "some.yaml", "application/yaml", b"a: 1\n")
        for topic, schema in (("/a", 0), ("/b", 1), ("/c", 0)):
            if topic != "/c":
                writer.register_schema(*SCHEMAS[schema])
            writer.register_channel(topic, "cdr", schema + 1, {"offered_qos_profiles": ""})
        for number, (channel, log_time_ns, data) in enumerate(messages):
            writer.add_message(channel, log_time_ns, data, log_time_ns, number)
        writer.add_metadata("last", {})
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part


def by_us(path: Path, messages: Iterable[tuple[int, int, bytes]], compression: Compression, *, cut: int = 0) -> None:
    with mcap_file(path, profile="ros2", compression=compression) as file:
        file.add_metadata("first", {"key": "value", "ä": ""})
        file.attach("some.yaml", "a: 1\n", 5)
        for topic, schema in (("/a", 0), ("/b", 1), ("/c", 0)):
            file.add_channel(topic, "cdr", SCHEMAS[schema], {"offered_qos_profiles": ""})
        for number, (channel, log_time_ns, data) in enumerate(messages):
            file.add_message(channel, log_time_ns, (data[:cut], memoryview(data)[cut:]) if cut else data, number)
        file.add_metadata("last", {})


LARGE = [(1 + row % 3, 1000 - row * 7 % 50, bytes([row, 1, 2]) * (100_000 * (row % 7))) for row in range(40)]
CASES: list[Messages] = [[], [(1, 7, b"")], [(2, 9, b"abc"), (1, 3, b"de"), (2, 3, b"f" * 5000)], LARGE]


@pytest.mark.parametrize("messages", CASES, ids=["none", "one", "small", "several chunks"])
@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_the_bytes_are_those_of_the_library(tmp_path: Path, messages: Messages, compression: Compression) -> None:
    with pytest.MonkeyPatch.context() as patch:
        compress = lz4.frame.compress
        patch.setattr("lz4.frame.compress", lambda data, **_: compress(data, compression_level=LZ4_LEVEL))
        by_library(tmp_path / "theirs.mcap", messages, compression)
    by_us(tmp_path / "ours.mcap", messages, compression)
    by_us(tmp_path / "parts.mcap", messages, compression, cut=2)
    expected = (tmp_path / "theirs.mcap").read_bytes()
    assert (tmp_path / "ours.mcap").read_bytes() == expected
    assert (tmp_path / "parts.mcap").read_bytes() == expected


@given(
    messages=st.lists(
        st.tuples(st.integers(1, 3), st.integers(0, 2**62), st.binary(max_size=50) | st.just(bytes(CHUNK_BYTES))),
        max_size=6,
    )
)
def test_any_messages_are_written_as_by_the_library(
    tmp_path_factory: pytest.TempPathFactory, messages: Messages
) -> None:
    folder = tmp_path_factory.mktemp("mcap")
    by_library(folder / "theirs.mcap", messages, "none")
    by_us(folder / "ours.mcap", messages, "none")
    assert (folder / "ours.mcap").read_bytes() == (folder / "theirs.mcap").read_bytes()


def test_every_record_can_be_read_with_its_checksum(tmp_path: Path) -> None:
    by_us(tmp_path / "out.mcap", LARGE, "lz4")
    with (tmp_path / "out.mcap").open("rb") as stream:
        count = sum(1 for _ in StreamReader(stream, validate_crcs=True).records)
        stream.seek(0)
        read = [
            (m.channel_id, m.log_time, m.data) for _, _, m in make_reader(stream).iter_messages(log_time_order=False)
        ]
    assert count > len(LARGE)
    assert read == LARGE


def test_an_error_in_the_block_is_the_one_that_is_raised(tmp_path: Path) -> None:
    def messages() -> Iterator[tuple[int, int, bytes]]:
        yield from [(1, 0, bytes(2 * CHUNK_BYTES))] * 5
        raise KeyError("in the block")

    with pytest.raises(KeyError, match="in the block"):
        by_us(tmp_path / "out.mcap", messages(), "none")
