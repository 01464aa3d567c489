"""What a ROS 2 recording in SQLite contains, according to its tables.

SQLite has no checksums and no fixed types of columns: values of other types than a recorder writes are taken where they
can mean only one thing.
"""

import sqlite3
from array import array
from collections.abc import Sequence
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.arrays import I64
from pipeline.core.errors import RecordingError
from pipeline.core.text import one_line
from readers.files.damage import Losses
from readers.location import Location

__all__ = ["Contents", "MissingRowsError", "contents_of_tables", "text_of", "without_early_times"]

ROWS_AT_ONCE = 1 << 14


class MissingRowsError(ValueError):
    """The table lacks messages that an index counts.

    Args:
        listed: Number of messages that the index counts.
        found: Number of messages in the table.
    """

    def __init__(self, listed: int, found: int) -> None:
        super().__init__(f"an index lists {listed} messages, the table has {found}")
        self.listed = listed


class Contents(NamedTuple):
    """What a database contains.

    Attributes:
        distro: ROS 2 release that recorded it, or empty.
        definitions: Encoding and text of the message definitions by type.
        rows: (N, 3) log time, id and topic id of every message, sorted by the first two; where the rows were found by
            reading every page (N, 5), with the page and the place in it.
        topics: Id, name, type and serialization format of the topics.
        type_hashes: By topic id.
    """

    distro: str
    definitions: dict[str, tuple[str, str]]
    rows: I64
    topics: list[tuple[int, str, str, str]]
    type_hashes: dict[int, str]


def contents_of_tables(database: sqlite3.Connection, path: Location, distro: str, losses: Losses) -> Contents:
    """What the tables of the database at `path` say.

    Args:
        database: The open database.
        path: Named in errors.
        distro: Used if the tables name no ROS 2 release.
        losses: Collects messages and topics that cannot be used.

    Raises:
        RecordingError: it is not a ROS 2 recording.
        MissingRowsError: the table lacks messages that an index counts.
        ValueError: the table of messages is not in the order of their ids.
        sqlite3.Error: the database is damaged.
    """
    query = database.execute
    query("PRAGMA trusted_schema = OFF")
    ordinary = "type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'"
    tables = {text_of(name) for (name,) in query(f"SELECT name FROM sqlite_master WHERE {ordinary}")}
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
        distro = next((text_of(name) for (name,) in query("SELECT ros_distro FROM schema") if name), distro)
    definitions = {}
    if "message_definitions" in tables:
        rows = query("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        definitions = {text_of(msgtype): (text_of(encoding), text_of(text)) for msgtype, encoding, text in rows}
    columns = _columns(database, "topics")
    hashes: dict[int, str] = {}
    if "type_description_hash" in columns:  # since Iron
        hashes = {id_: text_of(digest) for id_, digest in query("SELECT id, type_description_hash FROM topics")}
    encoding = "serialization_format" if "serialization_format" in columns else "'cdr'"
    topics = query(f"SELECT id, name, type, {encoding} FROM topics ORDER BY id")
    in_time = without_early_times(_rows(database, losses), losses)
    return Contents(distro, definitions, in_time, _topics(topics.fetchall(), losses), hashes)


def text_of(value: object) -> str:
    """A value that should be text: some recorders and tools write it as bytes, and damage makes it anything."""
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return "" if value is None else str(value)


def without_early_times(rows: I64, losses: Losses) -> I64:
    """The rows of messages since 1970; the others are noted."""
    count = int(np.searchsorted(rows[:, 0], 0))
    if count:
        first_ns, id_ = rows[0, :2].tolist()
        reason = f"messages of log times before 1970, the first of them message {id_} ({first_ns} ns)"
        losses.note(0, reason, messages=count)
    return rows[count:]


def _topics(rows: Sequence[tuple[Any, ...]], losses: Losses) -> list[tuple[int, str, str, str]]:
    topics = []
    for id_, name, msgtype, encoding in rows:
        if not isinstance(id_, int) or name is None or msgtype is None:
            reason = f"a topic without a number, name or type (found {id_!r}, {name!r}, {msgtype!r})"
            losses.note(0, one_line(reason, max_characters=200))
            continue
        topics.append((id_, text_of(name), text_of(msgtype), text_of(encoding)))
    return topics


def _rows(database: sqlite3.Connection, losses: Losses) -> I64:
    """`Contents.rows`, from the table alone: damage to an index on the time does not move messages."""
    values, last, unusable = array("q"), -(2**63) - 1, 0
    found = database.execute("SELECT timestamp, id, topic_id FROM messages NOT INDEXED")
    while block := found.fetchmany(ROWS_AT_ONCE):
        before = len(values)
        try:
            values.extend(chain.from_iterable(block))
        except (TypeError, OverflowError):
            del values[before:]
            unusable += len(block)
            block = [row for row in block if _is_usable(row, losses)]
            unusable -= len(block)
            values.extend(chain.from_iterable(block))
        ids = [last, *(row[1] for row in block)]
        if any(first >= second for first, second in pairwise(ids)):  # also ends a tree that contains itself
            raise ValueError("the messages are not in the order of their ids")
        last = ids[-1]
    rows = np.frombuffer(values, np.int64).reshape(-1, 3)
    ((listed,),) = database.execute("SELECT count(*) FROM messages")  # by an index, if there is one
    if listed > len(rows) + unusable:
        raise MissingRowsError(listed, len(rows) + unusable)
    if (rows[1:, 0] < rows[:-1, 0]).any():
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return rows


def _is_usable(row: tuple[Any, ...], losses: Losses) -> bool:
    """Whether the log time, id and topic id of a message are integers; else they are noted."""
    if all(isinstance(value, int) for value in row):
        return True
    time, id_, topic_id = (one_line(repr(value), max_characters=50) for value in row)
    losses.note(0, f"message {id_}: expected integers, found log time {time} and topic {topic_id}", messages=1)
    return False


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {text_of(column[1]) for column in database.execute(f"PRAGMA table_info({table})")}
