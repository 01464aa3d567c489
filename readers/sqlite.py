"""ROS 2 recordings in SQLite (rosbag2_storage_sqlite3, schema versions 1 to 4).

Read with Python's sqlite3: the order of equal times is then that of the rows, the sort never holds message data (a
database without index on the time would otherwise be sorted whole), and an empty serialization format passes.
"""

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Literal

import zstandard
from rosbags.typesys.msg import normalize_msgtype

from pipeline.errors import RecordingError
from pipeline.types import Channel, RawMessage
from readers.base import RosVersion, TopicInfo, merge_topics
from readers.peek import stamp_or_log_time

__all__ = ["SqliteFile"]

DEFINITION_FORMATS: dict[str, Literal["ros2msg", "ros2idl"]] = {"ros2msg": "ros2msg", "ros2idl": "ros2idl"}


class SqliteFile:
    """One open .db3 file; see `RecordingFile`.

    Args:
        path: The file.
        file_index: Its place in the recording.
        location: Where it lies unpacked, if not at `path`.
        message_compression: Whether each message is compressed with zstd (metadata.yaml says so).
        distro: ROS 2 release that metadata.yaml names; the file's own word goes first.
    """

    ros_version: RosVersion = "ROS 2"

    def __init__(
        self,
        path: Path,
        file_index: int,
        *,
        location: Path | None = None,
        message_compression: bool = False,
        distro: str = "",
    ) -> None:
        self.path = path
        self._file_index = file_index
        self._decompressor = zstandard.ZstdDecompressor() if message_compression else None
        location = path if location is None else location
        journal = location.with_name(location.name + "-wal")
        if journal.is_file() and journal.stat().st_size:
            raise RecordingError(
                f"{path}: the recorder did not close it, part of it is still in {journal.name}; "
                f"`sqlite3 {path.name} 'PRAGMA wal_checkpoint'` in a copy of the folder completes it"
            )
        # immutable: no lock, no journal, so that recordings on read-only media open too
        uri = f"{location.resolve().as_uri()}?mode=ro&immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        try:
            self._describe(distro)
        except BaseException:
            self._database.close()
            raise

    def _describe(self, distro: str) -> None:
        tables = {name for (name,) in self._query("SELECT name FROM sqlite_master WHERE type='table'")}
        if not {"topics", "messages"} <= tables:
            raise RecordingError(
                f"{self.path}: expected a ROS 2 recording (tables topics and messages), "
                f"found an SQLite database with {', '.join(sorted(tables)) or 'no tables'}"
            )
        if "schema" in tables:
            columns = {column[1] for column in self._query("PRAGMA table_info(schema)")}
            if "ros_distro" in columns:
                distro = next((name for (name,) in self._query("SELECT ros_distro FROM schema") if name), distro)
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            rows = self._query("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            definitions = {msgtype: (encoding, text) for msgtype, encoding, text in rows}

        counts = {
            topic_id: (count, first, last)
            for topic_id, count, first, last in self._query(
                "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
            )
        }
        self._channels: dict[int, Channel] = {}
        topics = []
        listed = set()
        for topic_id, topic, recorded_type, encoding in self._query(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        ):
            listed.add(topic_id)
            msgtype = normalize_msgtype(recorded_type)
            count = counts.get(topic_id, (0,))[0]
            if encoding not in {"cdr", ""}:
                reason = f"its messages are serialised as {encoding}, lidcam reads cdr"
                topics.append(TopicInfo(topic, msgtype, count, (), reason))
                continue
            found = definitions.get(recorded_type, ("", ""))
            known = DEFINITION_FORMATS.get(found[0])
            channel = Channel(topic, msgtype, "cdr", found[1] if known else "", known or "ros2msg", distro)
            self._channels[topic_id] = channel
            topics.append(TopicInfo(topic, msgtype, count, (channel,)))
        unlisted = sum(count for topic_id, (count, _, _) in counts.items() if topic_id not in listed)
        if unlisted:
            raise ValueError(f"{unlisted} messages of a topic that it does not list")
        self.topics = merge_topics(topics)
        self.message_count = sum(count for count, _, _ in counts.values())
        self.start_ns = min((first for _, first, _ in counts.values()), default=0)
        self.end_ns = max((last for _, _, last in counts.values()), default=0)

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = [id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics]
        conditions = [f"topic_id IN ({', '.join('?' * len(wanted))})"]
        values = [*wanted]
        if start_ns is not None:
            conditions.append("timestamp >= ?")
            values.append(start_ns)
        if stop_ns is not None:
            conditions.append("timestamp < ?")
            values.append(stop_ns)
        order = f"SELECT id, topic_id, timestamp FROM messages WHERE {' AND '.join(conditions)} ORDER BY timestamp, id"
        for row_id, topic_id, log_time_ns in self._query(order, values):
            ((data,),) = self._query("SELECT data FROM messages WHERE id = ?", [row_id])
            if not isinstance(data, bytes):
                raise TypeError(f"message {row_id} has no bytes")
            if self._decompressor is not None:
                data = self._decompressor.decompress(data)
            channel = self._channels[topic_id]
            yield RawMessage(
                stamp_or_log_time(channel, data, log_time_ns), log_time_ns, (self._file_index, row_id), data, channel
            )

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _query(self, sql: str, values: Collection[Any] = ()) -> Iterator[tuple[Any, ...]]:
        return self._database.execute(sql, tuple(values))
