"""What a ROS 2 recording in SQLite contains, according to its tables."""

import sqlite3
from typing import NamedTuple

from pipeline.core.errors import RecordingError
from readers.location import Location

__all__ = ["Contents", "contents_of_tables"]


class Contents(NamedTuple):
    """What a database contains.

    Attributes:
        distro: ROS 2 release that recorded it, or empty.
        definitions: Encoding and text of the message definitions by type.
        spans: Number of messages, first and last log time by topic id.
        topics: Id, name, type and serialization format of the topics.
        type_hashes: By topic id.
    """

    distro: str
    definitions: dict[str, tuple[str, str]]
    spans: dict[int, tuple[int, int, int]]
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
        TypeError: a message has no log time.
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
    spans = {
        topic_id: (count, first, last)
        for topic_id, count, first, last in query(
            "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
        )
    }
    if not all(isinstance(time, int) for _, *span in spans.values() for time in span):
        raise TypeError("a message whose log time is not an integer")
    hashes: dict[int, str] = {}
    if "type_description_hash" in _columns(database, "topics"):  # since Iron
        hashes = dict(query("SELECT id, type_description_hash FROM topics"))
    topics = query("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
    return Contents(distro, definitions, spans, list(topics), hashes)


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {column[1] for column in database.execute(f"PRAGMA table_info({table})")}
