"""Recordings in SQLite whose tables hold other values than a recorder writes, or are built differently."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from sound_recordings import read_all, sound_recording, write_files

from lidcam.pipeline.core.errors import RecordingError

SOUND = sound_recording("sqlite")
ROWS = len(SOUND.messages)


def changed(tmp_path: Path, *statements: str) -> Path:
    path = write_files(tmp_path, SOUND, SOUND.files)
    with closing(sqlite3.connect(path)) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
    return path


def rebuilt(columns: str, constraint: str = "", selected: str = "*") -> tuple[str, ...]:
    """Statements that give the table of messages other columns."""
    return (
        "DROP INDEX timestamp_idx",
        "ALTER TABLE messages RENAME TO old",
        f"CREATE TABLE messages({columns}){constraint}",
        f"INSERT INTO messages SELECT {selected} FROM old",
    )


@pytest.mark.parametrize(
    ("statements", "left", "told"),
    [
        (("UPDATE messages SET timestamp = -5 WHERE id = 3",), ROWS - 1, "before 1970, the first of them message 3"),
        (("UPDATE messages SET timestamp = -timestamp WHERE id < 9",), ROWS - 8, "before 1970"),
        (("UPDATE messages SET timestamp = 'late' WHERE id = 3",), ROWS - 1, "SQLite cannot read all of it"),
        (("UPDATE messages SET topic_id = 1e300 WHERE id = 3",), ROWS - 1, "SQLite cannot read all of it"),
        (rebuilt("id, topic_id, timestamp, data"), ROWS, ""),
        (("UPDATE messages SET id = 9223372036854775807 WHERE id = 3",), ROWS, ""),
        (("UPDATE messages SET id = -id",), ROWS, ""),
        (("UPDATE topics SET name = CAST(name AS BLOB), type = CAST(type AS BLOB)",), ROWS, ""),
        (
            ("UPDATE message_definitions SET encoded_message_definition = CAST(encoded_message_definition AS BLOB)",),
            ROWS,
            "",
        ),
        (("UPDATE message_definitions SET encoding = x'ff', topic_type = 5 WHERE rowid = 1",), ROWS, ""),
        (("DROP INDEX timestamp_idx",), ROWS, ""),
        (("DROP TABLE message_definitions",), ROWS, ""),
        (("DELETE FROM messages WHERE id IN (3, 4)",), ROWS - 2, ""),
    ],
)
def test_other_values(tmp_path: Path, statements: tuple[str, ...], left: int, told: str) -> None:
    messages, losses = read_all(changed(tmp_path, *statements), "as_needed")
    reasons = "; ".join(loss.reason for loss in losses)
    assert len(messages) == left, reasons
    assert {message.name for message in messages} == {message.name for message in SOUND.messages}
    assert told in reasons if told else not reasons, reasons


def test_names_that_are_no_text_become_text(tmp_path: Path) -> None:
    path = changed(
        tmp_path,
        "UPDATE topics SET name = CAST(x'2FFF' AS TEXT) WHERE id = 1",
        "UPDATE topics SET name = 5 WHERE id = 2",
    )
    messages, losses = read_all(path, "as_needed")
    assert {message.name[0] for message in messages} == {"/\ufffd", "5", "/tick"}
    assert not losses


@pytest.mark.parametrize(
    ("statements", "said"),
    [
        (("DROP TABLE messages",), "tables topics and messages"),
        (("ALTER TABLE messages RENAME TO m", "CREATE VIEW messages AS SELECT * FROM m"), "tables topics and messages"),
        (("DROP INDEX timestamp_idx", "ALTER TABLE messages DROP COLUMN timestamp"), "messages without timestamp"),
        (("ALTER TABLE topics DROP COLUMN type",), "a table topics without type"),
    ],
)
def test_other_tables_are_refused_in_one_line(tmp_path: Path, statements: tuple[str, ...], said: str) -> None:
    with pytest.raises(RecordingError, match=said) as caught:
        read_all(changed(tmp_path, *statements), "as_needed")
    assert "\n" not in str(caught.value)
