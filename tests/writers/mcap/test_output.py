"""A written MCAP file: its messages in order, its checksums and its index."""

from pathlib import Path
from typing import Literal

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from lidcam.writers.mcap.output import mcap_file
from lidcam.writers.outputs.marks import LIBRARY

SCHEMAS = [("a/msg/A", "ros2msg", b"int8 a"), ("b/msg/B", "ros2msg", b"")]
Messages = list[tuple[int, int, bytes]]
"""Channel from 1, log time, data."""

LARGE = [(1 + row % 3, 1000 - row * 7 % 50, bytes([row, 1, 2]) * (100_000 * (row % 7))) for row in range(40)]


@pytest.mark.parametrize("messages", [[], [(1, 7, b"")], LARGE], ids=["none", "one", "several chunks"])
@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_what_is_written_is_read(
    tmp_path: Path, messages: Messages, compression: Literal["none", "lz4", "zstd"]
) -> None:
    path = tmp_path / "out.mcap"
    with mcap_file(path, profile="ros2", compression=compression) as file:
        file.attach("some.yaml", "a: 1\n", 5)
        for topic, schema in (("/a", 0), ("/b", 1), ("/c", 0)):
            file.add_channel(topic, "cdr", SCHEMAS[schema], {"offered_qos_profiles": ""})
        for number, (channel, log_time_ns, data) in enumerate(messages):
            file.add_message(channel, log_time_ns, memoryview(data), number)
        file.add_metadata("last", {"key": "value", "ä": ""})
    with path.open("rb") as stream:
        assert sum(1 for _ in StreamReader(stream, validate_crcs=True).records) > len(messages)
        stream.seek(0)
        reader = make_reader(stream)
        found = [(m.channel_id, m.log_time, m.data) for _, _, m in reader.iter_messages(log_time_order=False)]
        assert found == messages
        assert (reader.get_header().library, reader.get_header().profile) == (LIBRARY, "ros2")
        assert [one.data for one in reader.iter_attachments()] == [b"a: 1\n"]
        assert [one.metadata for one in reader.iter_metadata()] == [{"key": "value", "ä": ""}]
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(messages)
    assert len(summary.channels) == 3
    assert [schema.name for schema in summary.schemas.values()] == ["a/msg/A", "b/msg/B"]
