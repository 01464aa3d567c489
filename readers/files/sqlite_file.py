"""ROS 2 recordings in SQLite (rosbag2_storage_sqlite3, schema versions 1 to 4).

Read with Python's sqlite3, so that messages of equal time come in the order of their rows, the sort never holds message
data, and an empty serialization format is accepted.
"""

import sqlite3
from array import array
from collections.abc import Collection, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.files.container import Container, Source
from lidcam.readers.files.copies import count_pages
from lidcam.readers.files.damage import LIBRARY_ERRORS, DamageGuard, Losses
from lidcam.readers.files.decompress import decompressed
from lidcam.readers.files.passes import pass_starts
from lidcam.readers.location import Location
from lidcam.readers.messages.header_stamp import stamp_or_log_time
from lidcam.readers.recording import RosVersion, TopicInfo, merge_topics

ROWS_AT_ONCE = 1 << 14
END_OF_IDS = 1 << 63
ROWS = "SELECT timestamp, id, topic_id FROM messages NOT INDEXED"
INTEGERS = " AND ".join(f"typeof({column}) = 'integer'" for column in ("timestamp", "id", "topic_id"))
"""Condition of a usable row: SQLite has no fixed types of columns."""


class Contents(NamedTuple):
    """Contents of a database."""

    distro: str  # ROS 2 release that recorded it, or empty
    definitions: dict[str, tuple[str, str]]  # Encoding and text of the message definitions by type
    rows: I64  # (N, 3) log time, id and topic id of every message, sorted by the first two
    topics: list[tuple[int, str, str, str]]  # Id, name, type and serialization format of the topics
    type_hashes: dict[int, str]  # By topic id


def contents_of_tables(
    database: sqlite3.Connection, path: Location, distro: str, losses: Losses, *, because: str = ""
) -> Contents:
    """Contents of the database at `path`; `distro` is that of the folder, used if the tables name none.

    `because` says why SQLite cannot read all of it: then damaged pages are passed over. It is empty if it can.
    """
    query = database.execute
    query("PRAGMA trusted_schema = OFF")
    query(f"PRAGMA writable_schema = {'ON' if because else 'OFF'}")  # else SQLite refuses a file that lacks pages

    def optional(text: str) -> list[tuple[Any, ...]]:
        """Rows without which messages can be read; none if they are damaged."""
        with DamageGuard(is_active=bool(because)):
            return query(text).fetchall()
        return []

    ordinary = "type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'"
    tables = {_text_of(name) for (name,) in query(f"SELECT name FROM sqlite_master WHERE {ordinary}")}
    if not {"topics", "messages"} <= tables:
        raise RecordingError(
            f"{path}: expected a ROS 2 recording (tables topics and messages), "
            f"found an SQLite database with {', '.join(sorted(tables)) or 'no tables'}"
        )
    for table, wanted in (("topics", {"id", "name", "type"}), ("messages", {"id", "topic_id", "timestamp", "data"})):
        if missing := wanted - _columns(database, table):
            raise RecordingError(
                f"{path}: expected a ROS 2 recording, found a table {table} without {', '.join(sorted(missing))}"
            )
    if "schema" in tables and "ros_distro" in _columns(database, "schema"):
        distro = next((_text_of(name) for (name,) in optional("SELECT ros_distro FROM schema") if name), distro)
    definitions = {}
    if "message_definitions" in tables:
        texts = optional("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        definitions = {_text_of(msgtype): (_text_of(encoding), _text_of(text)) for msgtype, encoding, text in texts}
    columns = _columns(database, "topics")
    hashes: dict[int, str] = {}
    if "type_description_hash" in columns:  # since Iron
        hashes = {id_: _text_of(digest) for id_, digest in optional("SELECT id, type_description_hash FROM topics")}
    encoding = "serialization_format" if "serialization_format" in columns else "'cdr'"
    named = "typeof(id) = 'integer' AND name IS NOT NULL AND type IS NOT NULL"
    found = query(f"SELECT id, name, type, {encoding} FROM topics WHERE {named} ORDER BY id").fetchall()
    topics = [(id_, _text_of(name), _text_of(msgtype), _text_of(form)) for id_, name, msgtype, form in found]
    rows = _rows_around_damage(database, losses, because) if because else _rows(database)
    return Contents(distro, definitions, _in_time(rows, losses), topics, hashes)


def _text_of(value: object) -> str:
    """A value that should be text: some recorders and tools write it as bytes."""
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return "" if value is None else str(value)


def _rows(database: sqlite3.Connection) -> I64:
    """(N, 3) as `Contents.rows`, by id, from the table alone: damage to an index on the time does not move messages."""
    values, found = array("q"), database.execute(ROWS)
    while block := found.fetchmany(ROWS_AT_ONCE):
        values.extend(chain.from_iterable(block))
    rows = np.frombuffer(values, np.int64).reshape(-1, 3)
    if (rows[1:, 1] <= rows[:-1, 1]).any():
        raise ValueError("the messages are not in the order of their ids")
    ((listed,),) = database.execute("SELECT count(*) FROM messages")  # by an index, if there is one
    if listed > len(rows):
        raise ValueError(f"an index lists {listed} messages, the table has {len(rows)}")
    return rows


def _rows_around_damage(database: sqlite3.Connection, losses: Losses, because: str) -> I64:
    """Rows like those of `_rows`; the ones that SQLite cannot read, or that hold no integers, are noted as one loss."""
    rows = np.array([*_readable_rows(database)], np.int64).reshape(-1, 3)
    found, listed = len(rows), _count(database, "messages")  # by an index, if there is one
    missing: int | None = max(int(rows[-1, 1]) if found else 0, found) - found  # recorders number from 1
    if listed is not None:
        missing = max(listed - found, 0)
    elif not missing and _count(database, "messages NOT INDEXED") is None:
        missing = None
    losses.note(0, f"SQLite cannot read all of it ({because}); {found} messages were found", messages=missing)
    return rows


def _count(database: sqlite3.Connection, source: str) -> int | None:
    """Number of rows; None if pages that are needed to count them are damaged."""
    with DamageGuard(is_active=True):
        return int(database.execute(f"SELECT count(*) FROM {source}").fetchone()[0])
    return None


def _readable_rows(database: sqlite3.Connection) -> Iterator[tuple[Any, ...]]:
    """The rows of messages by id; behind a page that cannot be read, the reading goes on at the next id that can."""
    first = 0
    while first < END_OF_IDS:
        with DamageGuard(is_active=True) as damage:
            for row in database.execute(f"{ROWS} WHERE id >= ? AND {INTEGERS}", (first,)):
                if row[1] < first:  # a tree that contains itself
                    return
                yield row
                first = row[1] + 1
        if damage.error is None:
            return
        first = _readable_from(database, first)


def _readable_from(database: sqlite3.Connection, broken: int) -> int:
    """The lowest id behind a broken one from which rows can be read; `END_OF_IDS` if there is none."""

    def is_readable(id_: int) -> bool:
        with DamageGuard(is_active=True) as damage:
            database.execute(f"{ROWS} WHERE id >= ? LIMIT 1", (id_,)).fetchall()
        return damage.error is None

    step = 1
    while broken + step < END_OF_IDS and not is_readable(broken + step):
        broken += step
        step *= 2
    if broken + step >= END_OF_IDS:
        return END_OF_IDS
    readable = broken + step
    while readable - broken > 1:
        middle = (readable + broken) // 2
        readable, broken = (middle, broken) if is_readable(middle) else (readable, middle)
    return readable


def _in_time(rows: I64, losses: Losses) -> I64:
    """The rows of messages since 1970 in the order of time; the others are noted."""
    if (rows[1:, 0] < rows[:-1, 0]).any():
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
    count = int(np.searchsorted(rows[:, 0], 0))
    if count:
        first_ns, id_ = rows[0, :2].tolist()
        reason = f"messages of log times before 1970, the first of them message {id_} ({first_ns} ns)"
        losses.note(0, reason, messages=count)
    return rows[count:]


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {_text_of(column[1]) for column in database.execute(f"PRAGMA table_info({table})")}


DEFINITION_FORMATS: dict[str, Literal["ros2msg", "ros2idl"]] = {"ros2msg": "ros2msg", "ros2idl": "ros2idl"}

MESSAGES_AT_ONCE = 4096


class SqliteFile(Container):
    """One open .db3 file; see `RecordingFile`. `content` is where the uncompressed bytes of `stream` lie."""

    ros_version: RosVersion = "ROS 2"

    def __init__(self, source: Source, stream: BinaryIO, content: Path) -> None:
        # immutable: no lock and no journal, so that recordings on read-only media open too
        uri = f"{content.resolve().as_uri()}?mode=ro&immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, source.options.limits.max_message_bytes)
        self._database.text_factory = lambda text: text.decode(errors="replace")
        try:
            super().__init__(source, stream)
        except BaseException:
            self._database.close()
            raise

    def _describe(self) -> None:
        distro = self._source.metadata.distro
        with self._losses.guard() as damage:
            pages = count_pages(self._stream)
            if pages.expected > pages.whole:
                raise EOFError(f"the file has {pages.whole} of {pages.expected} pages: it was cut off")
            contents = contents_of_tables(self._database, self.path, distro, self._losses)
        if damage.error:
            because = damage.reason
            contents = contents_of_tables(self._database, self.path, distro, self._losses, because=because)
            if not len(contents.rows):
                raise damage.error
        self._channels: dict[int, Channel] = {}
        topics = []
        ids, numbers = np.unique(contents.rows[:, 2], return_counts=True)
        self._counts: dict[int, int] = dict(zip(ids.tolist(), numbers.tolist(), strict=True))
        for topic_id, topic, recorded_type, encoding in contents.topics:
            msgtype = normalize_msgtype(recorded_type)
            count = self._counts.get(topic_id, 0)
            if encoding not in {"cdr", ""}:
                reason = f"its messages are serialised as {' '.join(encoding.split())[:50]}, lidcam reads cdr"
                topics.append(TopicInfo(topic, msgtype, count, (), reason))
                continue
            form, text = contents.definitions.get(recorded_type, ("", ""))
            known = DEFINITION_FORMATS.get(form)
            digest = contents.type_hashes.get(topic_id) or ""
            channel = Channel(topic, msgtype, "cdr", text if known else "", known or "ros2msg", contents.distro, digest)
            self._channels[topic_id] = channel
            topics.append(TopicInfo(topic, msgtype, count, (channel,)))
        self._rows = self._of_topics(contents.rows, [topic_id for topic_id, *_ in contents.topics])
        if unlisted := len(contents.rows) - len(self._rows):
            self._losses.note(0, "messages of a topic that the file does not list", messages=unlisted)
        self._passes = _passes(self._rows)
        self.topics = merge_topics(topics)
        self.message_count = len(self._rows)
        self.start_ns, self.end_ns = (int(self._rows[i, 0]) if self.message_count else 0 for i in (0, -1))

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = [id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics]
        for rows in self._passes:
            yield from self._messages_of(self._of_topics(rows, wanted), start_ns, stop_ns)

    def _of_topics(self, rows: I64, topic_ids: Collection[int]) -> I64:
        """Rows of some topics, not copied if these are all."""
        if self._counts.keys() <= {*topic_ids}:
            return rows
        return rows[np.isin(rows[:, 2], [*topic_ids])]

    def _messages_of(self, rows: I64, start_ns: int | None, stop_ns: int | None) -> Iterator[RawMessage]:
        """Messages of one pass of the recorder's clock."""
        rows = rows[slice(*(None if t is None else int(np.searchsorted(rows[:, 0], t)) for t in (start_ns, stop_ns)))]
        for first in range(0, len(rows), MESSAGES_AT_ONCE):
            for log_time_ns, row_id, topic_id in rows[first : first + MESSAGES_AT_ONCE].tolist():
                channel, data = self._channels[topic_id], self._read_or_note(log_time_ns, row_id)
                if data is not None:
                    order = self._source.index, row_id
                    yield RawMessage(stamp_or_log_time(channel, data, log_time_ns), log_time_ns, order, data, channel)

    def _read_or_note(self, log_time_ns: int, row_id: int) -> bytes | memoryview | None:
        """The bytes of a message; None if they are damaged, which is noted."""
        self._check_open()
        try:
            data = self._read(log_time_ns, row_id)
            if not isinstance(data, bytes):
                raise TypeError(f"message {row_id} has no bytes")
            announced, largest = self._source.metadata.message_compression, self._limits.max_message_bytes
            return decompressed(data, "cdr", announced=announced, largest=largest)
        except LIBRARY_ERRORS as err:
            self._losses.note(0, f"message {row_id}: {self._losses.reason(err)}", messages=1)
            return None

    def _read(self, log_time_ns: int, row_id: int) -> Any:
        try:
            row = self._database.execute("SELECT data, timestamp FROM messages WHERE id = ?", (row_id,)).fetchone()
        except sqlite3.DataError as err:
            raise ValueError(f"more than {self._limits.max_message_bytes} bytes, see limit_scale") from err
        if row is None or row[1] != log_time_ns:
            raise sqlite3.DatabaseError("its id leads to another row, or to none")
        return row[0]

    def close(self) -> None:
        """Close the database."""
        self._database.close()
        super().close()


def _passes(rows: I64) -> list[I64]:
    """The rows of each pass of the recorder's clock, as sorted as all of them; ids rise in the order of writing."""
    if (rows[1:, 1] > rows[:-1, 1]).all():  # log times rise through the file
        return [rows]
    in_file = np.argsort(rows[:, 1])
    starts = pass_starts(rows[in_file, 0], rows[in_file, 2])
    if not starts:
        return [rows]
    return [rows[np.sort(places)] for places in np.split(in_file, starts)]
