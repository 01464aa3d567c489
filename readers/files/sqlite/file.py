"""ROS 2 recordings in SQLite (rosbag2_storage_sqlite3, schema versions 1 to 4).

Read with Python's sqlite3, so that messages of equal time come in the order of their rows, the sort never holds message
data (SQLite would otherwise sort whole rows if the time has no index), and an empty serialization format is accepted.
"""

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from pipeline.core.messages import Channel, RawMessage
from readers.files.container import Container, Source
from readers.files.message_zstd import decompressed
from readers.files.sqlite.index import Contents, contents_of_tables
from readers.files.sqlite.recovery import Scanned, check_size, contents_of_rows, read_message, scan_database
from readers.messages.header_stamp import stamp_or_log_time
from readers.recording import RosVersion, TopicInfo, merge_topics

__all__ = ["SqliteFile"]

DEFINITION_FORMATS: dict[str, Literal["ros2msg", "ros2idl"]] = {"ros2msg": "ros2msg", "ros2idl": "ros2idl"}

STEPS_PER_BYTE = 20
"""Steps of SQLite's virtual machine allowed per byte of the file: rows of twelve bytes take thirty. Without a limit,
damaged pages that refer to one another in circles would keep it busy forever."""

MIN_STEPS = 10_000_000
STEPS_AT_ONCE = 100_000


class SqliteFile(Container):
    """One open .db3 file; see `RecordingFile`.

    Args:
        source: The file.
        content: Where its uncompressed content is.
    """

    ros_version: RosVersion = "ROS 2"

    def __init__(self, source: Source, content: Path) -> None:
        # immutable: no lock and no journal, so that recordings on read-only media open too
        uri = f"{content.resolve().as_uri()}?mode=ro&immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, source.options.limits.max_message_bytes)
        self._max_steps = MIN_STEPS + STEPS_PER_BYTE * content.stat().st_size
        self._steps = 0
        self._database.set_progress_handler(self._count_steps, STEPS_AT_ONCE)
        super().__init__(source, content.open("rb"))

    def _describe(self) -> None:
        self._scanned: Scanned | None = None
        distro = self._source.metadata.distro
        with self._losses.guard() as damage:
            check_size(self._stream)
            self._set_contents(contents_of_tables(self._database, self.path, distro))
        if damage.error:
            self._scanned = scan_database(self._stream, self._losses, because=damage.reason)
            if not len(self._scanned.rows):
                raise damage.error
            self._set_contents(contents_of_rows(self._scanned, distro))

    def _set_contents(self, contents: Contents) -> None:
        self._channels: dict[int, Channel] = {}
        topics = []
        spans = contents.spans
        for topic_id, topic, recorded_type, encoding in contents.topics:
            msgtype = normalize_msgtype(recorded_type)
            count = spans.get(topic_id, (0,))[0]
            if encoding not in {"cdr", ""}:
                reason = f"its messages are serialised as {encoding}, lidcam reads cdr"
                topics.append(TopicInfo(topic, msgtype, count, (), reason))
                continue
            form, text = contents.definitions.get(recorded_type, ("", ""))
            known = DEFINITION_FORMATS.get(form)
            digest = contents.type_hashes.get(topic_id) or ""
            channel = Channel(topic, msgtype, "cdr", text if known else "", known or "ros2msg", contents.distro, digest)
            self._channels[topic_id] = channel
            topics.append(TopicInfo(topic, msgtype, count, (channel,)))
        listed = {topic_id for topic_id, *_ in contents.topics}
        if unlisted := sum(count for topic_id, (count, _, _) in spans.items() if topic_id not in listed):
            self._losses.note(0, "messages of a topic that the file does not list", messages=unlisted)
            spans = {topic_id: span for topic_id, span in spans.items() if topic_id in listed}
        self.topics = merge_topics(topics)
        self.message_count = sum(count for count, _, _ in spans.values())
        self.start_ns = min((first for _, first, _ in spans.values()), default=0)
        self.end_ns = max((last for _, _, last in spans.values()), default=0)

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = [id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics]
        for row_id, topic_id, log_time_ns, data in self._rows(wanted, start_ns, stop_ns):
            channel = self._channels[topic_id]
            order = self._source.index, row_id
            yield RawMessage(stamp_or_log_time(channel, data, log_time_ns), log_time_ns, order, data, channel)

    def _rows(
        self, wanted: list[int], start_ns: int | None, stop_ns: int | None
    ) -> Iterator[tuple[int, int, int, bytes | memoryview]]:
        """Id, topic id, log time and data: from SQLite, and from the pages once it fails."""
        self._check_open()
        last = -(2**63), -(2**63)  # log time and id
        if self._scanned is None:
            conditions = [f"topic_id IN ({', '.join('?' * len(wanted))})"]
            values = [*wanted]
            if start_ns is not None:
                conditions.append("timestamp >= ?")
                values.append(start_ns)
            if stop_ns is not None:
                conditions.append("timestamp < ?")
                values.append(stop_ns)
            order = (
                f"SELECT id, topic_id, timestamp FROM messages WHERE {' AND '.join(conditions)} ORDER BY timestamp, id"
            )
            with self._losses.guard() as damage:
                for row_id, topic_id, log_time_ns in self._query(order, values):
                    ((data, time_ns),) = self._query("SELECT data, timestamp FROM messages WHERE id = ?", [row_id])
                    if time_ns != log_time_ns or not isinstance(time_ns, int) or (time_ns, row_id) <= last:
                        _refuse_index(row_id)
                    last = time_ns, row_id
                    if (content := self._content_of(row_id, data)) is not None:
                        yield row_id, topic_id, log_time_ns, content
                        self._check_open()
            if not damage.error:
                return
            self._scanned = scan_database(self._stream, self._losses, because=damage.reason)
        rows = self._scanned.rows[np.isin(self._scanned.rows[:, 2], wanted)]
        rows = rows[slice(*(None if t is None else int(np.searchsorted(rows[:, 0], t)) for t in (start_ns, stop_ns)))]
        for log_time_ns, row_id, topic_id, page, place in rows.tolist():
            if (log_time_ns, row_id) <= last:
                continue
            self._check_open()
            with self._losses.guard() as damage:
                data = read_message(self._stream, page, place)
            if damage.error:
                self._note(row_id, damage.reason)
            elif (content := self._content_of(row_id, data)) is not None:
                yield row_id, topic_id, log_time_ns, content

    def _content_of(self, row_id: int, data: Any) -> bytes | memoryview | None:
        """The bytes of a message; None if they are damaged, which is noted."""
        largest = self._limits.max_message_bytes
        with self._losses.guard() as damage:
            if not isinstance(data, bytes):
                raise TypeError(f"message {row_id} has no bytes")
            if len(data) > largest:
                raise ValueError(f"{len(data)} bytes, see limits.max_message_mib")
            return decompressed(data, "cdr", announced=self._source.metadata.message_compression, largest=largest)
        self._note(row_id, damage.reason)
        return None

    def _note(self, row_id: int, reason: str) -> None:
        self._losses.note(0, f"message {row_id}: {reason}", messages=1)

    def close(self) -> None:
        """Close the database."""
        self._database.close()
        super().close()

    def _query(self, sql: str, values: Collection[Any] = ()) -> Iterator[tuple[Any, ...]]:
        self._steps = 0
        return self._database.execute(sql, tuple(values))

    def _count_steps(self) -> bool:
        """Whether SQLite is to give up."""
        self._steps += STEPS_AT_ONCE
        return self._steps > self._max_steps


def _refuse_index(row_id: int) -> NoReturn:
    raise sqlite3.DatabaseError(f"the index on the time is wrong about message {row_id}")
