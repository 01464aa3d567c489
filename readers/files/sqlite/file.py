"""ROS 2 recordings in SQLite (rosbag2_storage_sqlite3, schema versions 1 to 4).

Read with Python's sqlite3: the order of equal times is then that of the rows, the sort never holds message data (a
database without index on the time would otherwise be sorted whole), and an empty serialization format passes.
"""

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Literal, NoReturn

import numpy as np
import zstandard
from rosbags.typesys.msg import normalize_msgtype

from pipeline.core.errors import RecordingError
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.files.damage import Losses, describe, is_damage
from readers.files.message_zstd import decompressed
from readers.files.sqlite.recovery import Walked, check_size, read_message, walk_database
from readers.messages.header_stamp import stamp_or_log_time
from readers.recording import Loss, RosVersion, TopicInfo, merge_topics

__all__ = ["SqliteFile"]

DEFINITION_FORMATS: dict[str, Literal["ros2msg", "ros2idl"]] = {"ros2msg": "ros2msg", "ros2idl": "ros2idl"}

Counts = dict[int, tuple[int, int, int]]
"""Number of messages, first and last log time by topic."""

STEPS_PER_BYTE = 20
"""Steps of SQLite's machine per byte of the file: rows of twelve bytes take thirty. Pages that refer to one another in
a net rather than a tree would keep it busy for ever."""

LEAST_STEPS = 10_000_000
STEPS_AT_ONCE = 100_000

TopicRow = tuple[int, str, str, str]
"""Id, name, type, serialisation."""


class SqliteFile:
    """One open .db3 file; see `RecordingFile`.

    Args:
        path: The file.
        file_index: Its place in the recording.
        location: Where it lies unpacked, if not at `path`.
        message_compression: Whether each message is compressed with zstd (metadata.yaml says so).
        distro: ROS 2 release that metadata.yaml names; the file's own word goes first.
        rescue: Read what can be read of a damaged file, and tell of the rest in `losses`.
        limits: How large its messages may be.
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
        rescue: bool = False,
        limits: LimitsConfig = DEFAULT_LIMITS,
    ) -> None:
        self.path = path
        self._file_index = file_index
        self._rescue = rescue
        self._limits = limits
        self._losses = Losses(path, limits.max_losses_listed)
        self._walked: Walked | None = None
        self._message_compression = message_compression
        self._type_hashes: dict[int, str] = {}
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
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits.max_message_bytes)
        self._most_steps = LEAST_STEPS + STEPS_PER_BYTE * location.stat().st_size
        self._steps = 0
        self._database.set_progress_handler(self._count_steps, STEPS_AT_ONCE)
        self._stream: BinaryIO = location.open("rb")
        try:
            try:
                self._describe(*self._contents(distro))
            except Exception as err:
                if not rescue or not is_damage(err):
                    raise
                self._walked = self._walk(err)
                if not len(self._walked.rows):
                    raise
                self._describe(*self._walked_contents(self._walked, distro))
        except BaseException:
            self.close()
            raise

    def _contents(self, distro: str) -> tuple[str, dict[str, tuple[str, str]], Counts, list[TopicRow]]:
        """Release, definitions by type, messages by topic, and topics."""
        check_size(self._stream)
        self._query("PRAGMA trusted_schema = OFF")
        ordinary = "type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'"
        tables = {name for (name,) in self._query(f"SELECT name FROM sqlite_master WHERE {ordinary}")}
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
        if not all(isinstance(time, int) for _, *span in counts.values() for time in span):
            raise TypeError("a message whose time is no number")
        if "type_description_hash" in {column[1] for column in self._query("PRAGMA table_info(topics)")}:  # since Iron
            self._type_hashes = dict(self._query("SELECT id, type_description_hash FROM topics"))
        topics = self._query("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
        return distro, definitions, counts, list(topics)

    def _walked_contents(
        self, walked: Walked, distro: str
    ) -> tuple[str, dict[str, tuple[str, str]], Counts, list[TopicRow]]:
        """The same from the rows that were found without SQLite."""
        ids, first, counts = np.unique(walked.rows[:, 2], return_index=True, return_counts=True)
        last = len(walked.rows) - 1 - np.unique(walked.rows[::-1, 2], return_index=True)[1]
        times = walked.rows[:, 0]
        spans = zip(ids.tolist(), counts.tolist(), times[first].tolist(), times[last].tolist(), strict=True)
        return (
            walked.distro or distro,
            walked.definitions,
            {id_: (count, begin, end) for id_, count, begin, end in spans},
            walked.topics,
        )

    def _walk(self, err: Exception) -> Walked:
        return walk_database(self._stream, self._losses, because=describe(err))

    def _describe(
        self, distro: str, definitions: dict[str, tuple[str, str]], counts: Counts, rows: list[TopicRow]
    ) -> None:
        self._channels: dict[int, Channel] = {}
        topics = []
        listed = set()
        for topic_id, topic, recorded_type, encoding in rows:
            listed.add(topic_id)
            msgtype = normalize_msgtype(recorded_type)
            count = counts.get(topic_id, (0,))[0]
            if encoding not in {"cdr", ""}:
                reason = f"its messages are serialised as {encoding}, lidcam reads cdr"
                topics.append(TopicInfo(topic, msgtype, count, (), reason))
                continue
            found = definitions.get(recorded_type, ("", ""))
            known = DEFINITION_FORMATS.get(found[0])
            text, digest = found[1] if known else "", self._type_hashes.get(topic_id) or ""
            channel = Channel(topic, msgtype, "cdr", text, known or "ros2msg", distro, digest)
            self._channels[topic_id] = channel
            topics.append(TopicInfo(topic, msgtype, count, (channel,)))
        unlisted = sum(count for topic_id, (count, _, _) in counts.items() if topic_id not in listed)
        if unlisted:
            if not self._rescue:
                raise ValueError(f"{unlisted} messages of a topic that it does not list")
            self._losses.note(0, "messages of a topic that the file does not list", messages=unlisted)
            counts = {topic_id: count for topic_id, count in counts.items() if topic_id in listed}
        self.topics = merge_topics(topics)
        self.message_count = sum(count for count, _, _ in counts.values())
        self.start_ns = min((first for _, first, _ in counts.values()), default=0)
        self.end_ns = max((last for _, _, last in counts.values()), default=0)

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = [id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics]
        for row_id, topic_id, log_time_ns, data in self._rows(wanted, start_ns, stop_ns):
            channel = self._channels[topic_id]
            yield RawMessage(
                stamp_or_log_time(channel, data, log_time_ns), log_time_ns, (self._file_index, row_id), data, channel
            )

    @property
    def losses(self) -> tuple[Loss, ...]:
        """See `RecordingFile`."""
        return self._losses.listed()

    def _rows(
        self, wanted: list[int], start_ns: int | None, stop_ns: int | None
    ) -> Iterator[tuple[int, int, int, bytes | memoryview]]:
        """Id, topic, log time and data: by SQLite, from where that fails by the pages."""
        last = -(2**63), -(2**63)  # log time and id
        if self._walked is None:
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
            try:
                for row_id, topic_id, log_time_ns in self._query(order, values):
                    ((data, time_ns),) = self._query("SELECT data, timestamp FROM messages WHERE id = ?", [row_id])
                    if time_ns != log_time_ns or not isinstance(time_ns, int) or (time_ns, row_id) <= last:
                        _refuse_index(row_id)
                    last = time_ns, row_id
                    if (content := self._content(row_id, data)) is not None:
                        yield row_id, topic_id, log_time_ns, content
            except sqlite3.DatabaseError as err:
                if not self._rescue or isinstance(err, sqlite3.ProgrammingError):
                    raise
                self._walked = self._walk(err)
            else:
                return
        rows = self._walked.rows[np.isin(self._walked.rows[:, 2], wanted)]
        rows = rows[slice(*(None if t is None else int(np.searchsorted(rows[:, 0], t)) for t in (start_ns, stop_ns)))]
        for log_time_ns, row_id, topic_id, page, place in rows.tolist():
            if (log_time_ns, row_id) <= last:
                continue
            try:
                data = read_message(self._stream, page, place)
            except Exception as err:
                if not is_damage(err):
                    raise
                self._losses.note(0, f"message {row_id}: {describe(err)}", messages=1)
                continue
            if (content := self._content(row_id, data)) is not None:
                yield row_id, topic_id, log_time_ns, content

    def _content(self, row_id: int, data: Any) -> bytes | memoryview | None:
        """The bytes of a message; None where they are damaged, which is noted."""
        try:
            if not isinstance(data, bytes):
                raise TypeError(f"message {row_id} has no bytes")  # noqa: TRY301  (one place that notes or raises)
            if len(data) > self._limits.max_message_bytes:
                raise ValueError(f"{len(data)} bytes, see limits.max_message_mib")  # noqa: TRY301  (the same)
            return decompressed(
                data, "cdr", announced=self._message_compression, largest=self._limits.max_message_bytes
            )
        except (TypeError, ValueError, zstandard.ZstdError) as err:
            if not self._rescue:
                raise
            self._losses.note(0, f"message {row_id}: {describe(err)}", messages=1)
            return None

    def close(self) -> None:
        """Close the database."""
        self._database.close()
        self._stream.close()

    def _query(self, sql: str, values: Collection[Any] = ()) -> Iterator[tuple[Any, ...]]:
        self._steps = 0
        return self._database.execute(sql, tuple(values))

    def _count_steps(self) -> bool:
        """Whether SQLite is to give up."""
        self._steps += STEPS_AT_ONCE
        return self._steps > self._most_steps


def _refuse_index(row_id: int) -> NoReturn:
    raise sqlite3.DatabaseError(f"the index on the time is wrong about message {row_id}")
