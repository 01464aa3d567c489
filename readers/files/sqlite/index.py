"""What a ROS 2 recording in SQLite contains, according to its tables.

SQLite has no checksums and no fixed types of columns. The times are compared with the index on them, which is a second
copy of each; values of other types than a recorder writes are taken where they can mean only one thing.
"""

import sqlite3
from array import array
from collections.abc import Mapping, Sequence
from itertools import chain, pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.arrays import I64
from pipeline.core.errors import RecordingError
from pipeline.core.text import one_line
from readers.files.damage import Losses
from readers.files.rows import sort_rows
from readers.location import Location

__all__ = ["Contents", "MissingRowsError", "contents_of_tables", "text_of", "without_early_times"]

ROWS_AT_ONCE = 1 << 14
BY_TIME = (0, 1)
"""Columns of the rows that they are sorted by: log time, id."""


class MissingRowsError(ValueError):
    """The table lacks messages that its index names.

    Args:
        reason: What is wrong.
        ids: (N,) of all messages that the index names.
    """

    def __init__(self, reason: str, ids: I64) -> None:
        super().__init__(reason)
        self.ids = ids


class Contents(NamedTuple):
    """What a database contains.

    Attributes:
        distro: ROS 2 release that recorded it, or empty.
        definitions: Encoding and text of the message definitions by type.
        rows: (N, 3) log time, id and topic id of every message, sorted by the first two; where the rows were found by
            reading every page (N, 5), with the page and the place in it.
        topics: Id, name, type and serialization format of the topics.
        type_hashes: By topic id.
        other_times_ns: Log time in the table, by id, of messages whose log time is taken from the index on it.
    """

    distro: str
    definitions: dict[str, tuple[str, str]]
    rows: I64
    topics: list[tuple[int, str, str, str]]
    type_hashes: dict[int, str]
    other_times_ns: Mapping[int, int] = MappingProxyType({})


def contents_of_tables(database: sqlite3.Connection, path: Location, distro: str, losses: Losses) -> Contents:
    """What the tables of the database at `path` say.

    Args:
        database: The open database.
        path: Named in errors.
        distro: Used if the tables name no ROS 2 release.
        losses: Collects messages and topics that cannot be used.

    Raises:
        RecordingError: it is not a ROS 2 recording.
        MissingRowsError: the table lacks messages that its index names.
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
    in_order, others = _compared(database, _rows(database, losses), losses)
    in_order = without_early_times(in_order, losses)
    return Contents(distro, definitions, in_order, _topics(topics.fetchall(), losses), hashes, others)


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
    """`Contents.rows`, from the table alone: damage to an index on the time neither hides nor moves messages."""
    values, last = array("q"), -(2**63) - 1
    found = database.execute("SELECT timestamp, id, topic_id FROM messages NOT INDEXED")
    while block := found.fetchmany(ROWS_AT_ONCE):
        before = len(values)
        try:
            values.extend(chain.from_iterable(block))
        except (TypeError, OverflowError):
            del values[before:]
            block = [row for row in block if _is_usable(row, losses)]
            values.extend(chain.from_iterable(block))
        ids = [last, *(row[1] for row in block)]
        if any(first >= second for first, second in pairwise(ids)):  # also ends a tree that contains itself
            raise ValueError("the messages are not in the order of their ids")
        last = ids[-1]
    rows = np.frombuffer(values, np.int64).reshape(-1, 3)
    sort_rows(rows, BY_TIME)
    return rows


def _is_usable(row: tuple[Any, ...], losses: Losses) -> bool:
    """Whether the log time, id and topic id of a message are integers; else they are noted."""
    if all(isinstance(value, int) for value in row):
        return True
    time, id_, topic_id = (one_line(repr(value), max_characters=50) for value in row)
    losses.note(0, f"message {id_}: expected integers, found log time {time} and topic {topic_id}", messages=1)
    return False


def _compared(database: sqlite3.Connection, rows: I64, losses: Losses) -> tuple[I64, dict[int, int]]:
    """The rows, compared with the index on the time, and `Contents.other_times_ns`.

    Nothing but the index itself is read.

    Raises:
        MissingRowsError: the index names messages that the table lacks.
    """
    names = [text_of(row[1]) for row in database.execute("PRAGMA index_list(messages)")]
    columns = {name: [row[2] for row in database.execute(f"PRAGMA index_info({_quoted(name)})")] for name in names}
    name = next((name for name in names if columns[name] == ["timestamp"]), None)
    if name is None:
        return rows, {}
    try:
        found = database.execute(f"SELECT timestamp, id FROM messages INDEXED BY {_quoted(name)} ORDER BY timestamp")
        listed = _other_listing(found, rows)
    except (sqlite3.Error, TypeError, OverflowError) as err:
        losses.note(0, f"its index on the time cannot be read ({losses.reason(err)}), and is not used", messages=0)
        return rows, {}
    if listed is None:
        return rows, {}
    missing = np.setdiff1d(listed[:, 1], rows[:, 1])
    if len(missing):
        reason = f"its index on the time names {len(missing)} messages that its table lacks"
        raise MissingRowsError(reason, listed[:, 1])
    return _with_fitting_times(rows, listed, losses)


def _other_listing(found: sqlite3.Cursor, rows: I64) -> I64 | None:
    """(M, 2) log times and ids that an index lists, sorted by both; None where they are those of the rows."""
    same = 0
    values: array[int] | None = None
    while block := found.fetchmany(ROWS_AT_ONCE):
        listed = array("q", chain.from_iterable(block))
        table = np.frombuffer(listed, np.int64).reshape(-1, 2)
        if values is None and np.array_equal(table, rows[same : same + len(table), :2]):
            same += len(table)
            continue
        if values is None:  # what was the same need not be read again
            values = array("q", rows[:same, :2].tobytes())
        values.extend(listed)
        if len(values) > 4 * (len(rows) + ROWS_AT_ONCE):  # the tree may contain itself
            break
    if values is None:
        if same == len(rows):
            return None
        values = array("q", rows[:same, :2].tobytes())
    other = np.frombuffer(values, np.int64).reshape(-1, 2)
    sort_rows(other, BY_TIME)
    return None if np.array_equal(other, rows[:, :2]) else other


def _with_fitting_times(rows: I64, listed: I64, losses: Losses) -> tuple[I64, dict[int, int]]:
    """The rows with the times of table or index, whichever fit between those of the messages before and behind."""
    rows = rows[np.argsort(rows[:, 1])]
    times = rows[:, 0]
    before, behind = np.r_[np.int64(0), times[:-1]], np.r_[times[1:], np.iinfo(np.int64).max]
    places = np.searchsorted(rows[:, 1], listed[:, 1])
    other = times.copy()
    other[places] = listed[:, 0]
    differs = np.flatnonzero(other != times)
    fits = (times >= before) & (times <= behind)
    taken = differs[~fits[differs] & ((other >= before) & (other <= behind))[differs]]
    for place in differs[:1].tolist():
        reason = f"the table and its index on the time differ in {len(differs)} messages, the first of them message "
        reason += f"{rows[place, 1]} ({times[place]} and {other[place]} ns); what fits its neighbours is used"
        losses.note(0, reason, messages=0)
    if not len(differs):
        losses.note(0, "its index on the time lacks messages or names them twice, and is not used", messages=0)
    in_table = dict(rows[taken][:, (1, 0)].tolist())
    rows[taken, 0] = other[taken]
    sort_rows(rows, BY_TIME)
    return rows, in_table


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {text_of(column[1]) for column in database.execute(f"PRAGMA table_info({table})")}


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
