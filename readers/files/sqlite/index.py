"""Contents of a ROS 2 recording in SQLite, according to its tables."""

import sqlite3
from array import array
from collections.abc import Iterator
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.files.damage import DamageGuard, Losses
from lidcam.readers.location import Location

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

    Raises:
        RecordingError: it is not a ROS 2 recording.
        ValueError: the table of messages lacks some that an index counts.
        TypeError: a message's time or topic is no integer.
        sqlite3.Error: the database is damaged.
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
