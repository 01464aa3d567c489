"""What a ROS 2 recording in SQLite contains, according to its tables."""

import sqlite3
from array import array
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import I64
from pipeline.core.errors import RecordingError
from readers.location import Location

__all__ = ["Contents", "contents_of_tables"]

ROWS_AT_ONCE = 1 << 14


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


def contents_of_tables(database: sqlite3.Connection, path: Location, distro: str) -> Contents:
    """What the tables of the database at `path` say.

    Args:
        database: The open database.
        path: Named in errors.
        distro: Used if the tables name no ROS 2 release.

    Raises:
        RecordingError: it is not a ROS 2 recording.
        TypeError: a log time or topic id is not an integer.
        ValueError: the table of messages is not in the order of their ids.
        sqlite3.Error: the database is damaged.
    """
    query = database.execute
    query("PRAGMA trusted_schema = OFF")
    ordinary = "type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'"
    tables = {name for (name,) in query(f"SELECT name FROM sqlite_master WHERE {ordinary}")}
    if not {"topics", "messages"} <= tables:
        raise RecordingError(
            f"{path}: expected a ROS 2 recording (tables topics and messages), "
            f"found an SQLite database with {', '.join(sorted(tables)) or 'no tables'}"
        )
    if "schema" in tables and "ros_distro" in _columns(database, "schema"):
        distro = next((name for (name,) in query("SELECT ros_distro FROM schema") if name), distro)
    definitions = {}
    if "message_definitions" in tables:
        rows = query("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        definitions = {msgtype: (encoding, text) for msgtype, encoding, text in rows}
    hashes: dict[int, str] = {}
    if "type_description_hash" in _columns(database, "topics"):  # since Iron
        hashes = dict(query("SELECT id, type_description_hash FROM topics"))
    topics = query("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
    return Contents(distro, definitions, _rows(database), list(topics), hashes)


def _rows(database: sqlite3.Connection) -> I64:
    """`Contents.rows`, from the table alone: damage to an index on the time neither hides nor moves messages."""
    values, last = array("q"), -(2**63) - 1
    found = database.execute("SELECT timestamp, id, topic_id FROM messages NOT INDEXED")
    while block := found.fetchmany(ROWS_AT_ONCE):
        values.extend(chain.from_iterable(block))
        ids = [last, *(row[1] for row in block)]
        if any(first >= second for first, second in pairwise(ids)):  # also ends a tree that contains itself
            raise ValueError("the messages are not in the order of their ids")
        last = ids[-1]
    rows = np.array(values, np.int64).reshape(-1, 3)
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {column[1] for column in database.execute(f"PRAGMA table_info({table})")}
