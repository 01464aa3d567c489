"""Recordings in SQLite: other values than a recorder writes, other tables, write-ahead logs and journals."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from builders import odometry, raw, write_rosbag2
from sound_recordings import read_all, sound_recording, write_files

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions

WAL = sound_recording("sqlite-wal")


def test_a_log_is_applied_as_far_as_it_is_sound(tmp_path: Path) -> None:
    log = WAL.files["rec.db3-wal"]
    for name, wal in {"sound": log, "cut": log[: len(log) // 2]}.items():
        (folder := tmp_path / name).mkdir()
        altered = {**WAL.files, "rec.db3-wal": wal}
        messages, losses = read_all(write_files(folder, WAL, altered), "as_needed")
        reasons = "; ".join(loss.reason for loss in losses)
        assert "completed from rec.db3-wal in a copy" in reasons
        assert ("pages of rec.db3-wal are damaged" in reasons) == (wal != log)
        assert (messages == WAL.messages) == (wal == log)
        assert {*messages} <= {*WAL.messages}


def half_written(tmp_path: Path) -> tuple[Path, bytes]:
    """A database with the journal of a write that was killed."""
    sound = sound_recording("sqlite")
    path = write_files(tmp_path, sound, sound.files)
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA cache_size=2")
        database.execute("BEGIN")
        database.execute("INSERT INTO messages SELECT id + 100, topic_id, timestamp + 9000000000, data FROM messages")
        journal = path.with_name("rec.db3-journal").read_bytes()
        content = path.read_bytes()
    path.write_bytes(content)
    assert content != sound.files["rec.db3"]
    return path, journal


def test_a_half_done_write_is_undone(tmp_path: Path) -> None:
    path, journal = half_written(tmp_path)
    path.with_name("rec.db3-journal").write_bytes(journal)
    messages, (loss,) = read_all(path, "as_needed")
    assert messages == sound_recording("sqlite").messages
    assert "completed from rec.db3-journal in a copy" in loss.reason


def test_the_journal_of_a_finished_write_is_none(tmp_path: Path) -> None:
    """With journal_mode=PERSIST, its first bytes are zeros then."""
    sound = sound_recording("sqlite")
    path = write_files(tmp_path, sound, sound.files)
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=PERSIST").fetchall()
        database.execute("UPDATE topics SET offered_qos_profiles = 'other'")
        journal = path.with_name("rec.db3-journal").read_bytes()
    assert journal[:8] == bytes(8)
    path.with_name("rec.db3-journal").write_bytes(journal)
    assert read_all(path, "none") == (sound.messages, ())


SOUND = sound_recording("sqlite")
ROWS = len(SOUND.messages)


def change(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()


def changed(tmp_path: Path, *statements: str) -> Path:
    path = write_files(tmp_path, SOUND, SOUND.files)
    change(path, *statements)
    return path


COLUMNS_OF_ANY_TYPE = (
    "DROP INDEX timestamp_idx",
    "ALTER TABLE messages RENAME TO old",
    "CREATE TABLE messages(id, topic_id, timestamp, data)",
    "INSERT INTO messages SELECT * FROM old",
)


@pytest.mark.parametrize(
    ("statements", "left", "told"),
    [
        (("UPDATE messages SET timestamp = -5 WHERE id = 3",), ROWS - 1, "before 1970, the first of them message 3"),
        (("UPDATE messages SET timestamp = -timestamp WHERE id < 9",), ROWS - 8, "before 1970"),
        (("UPDATE messages SET timestamp = 'late' WHERE id = 3",), ROWS - 1, "SQLite cannot read all of it"),
        (("UPDATE messages SET topic_id = 1e300 WHERE id = 3",), ROWS - 1, "SQLite cannot read all of it"),
        (COLUMNS_OF_ANY_TYPE, ROWS, ""),
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


T0 = 1_700_000_000 * 10**9
ODOMETRY = "nav_msgs/msg/Odometry"


def states(log_times_ns: list[int], topic: str = "/odom") -> list[RawMessage]:
    return [raw(topic, ODOMETRY, odometry(stamp_ns=T0 + i), T0 + i, log) for i, log in enumerate(log_times_ns)]


@pytest.fixture
def database(tmp_path: Path) -> Path:
    write_rosbag2(tmp_path / "rec", states([50, 30, 80, 80, 10]))
    return tmp_path / "rec" / "rec.db3"


def stamps(path: Path) -> list[int]:
    with open_recording([path], ReadOptions("none")) as recording:
        return [m.stamp_ns - T0 for m in recording.messages()]


def test_order_without_an_index_on_the_time(database: Path) -> None:
    change(database, "DROP INDEX IF EXISTS timestamp_idx")
    assert stamps(database) == [4, 1, 0, 2, 3]


def test_databases_before_definitions_were_recorded(database: Path) -> None:
    """Schema version 1 (Dashing): no qos, no definitions; the type is a common one."""
    change(
        database,
        "DROP TABLE schema",
        "DROP TABLE message_definitions",
        "ALTER TABLE topics DROP COLUMN type_description_hash",
        "ALTER TABLE topics DROP COLUMN offered_qos_profiles",
        "UPDATE topics SET serialization_format = ''",
    )
    assert stamps(database.parent) == [4, 1, 0, 2, 3]
    with open_recording([database]) as recording:
        message = next(recording.messages())
    assert message.channel.definition == ""
    assert deserialize(message).child_frame_id == "base_link"


def test_other_serialisations_are_listed_with_the_reason(database: Path) -> None:
    change(database, "UPDATE topics SET serialization_format = 'fory'")
    with open_recording([database]) as recording:
        assert list(recording.messages()) == []
        (info,) = recording.topics
    assert (info.message_count, info.channels) == (5, ())
    assert "serialised as fory" in info.unreadable


def test_the_release_is_that_of_the_file_then_of_the_folder(database: Path) -> None:
    for distro, expected in (("jazzy", "jazzy"), ("", "rosbags")):
        change(database, f"UPDATE schema SET ros_distro = '{distro}'")
        with open_recording([database]) as recording:
            assert recording.topics[0].channel.distro == expected


def test_a_message_without_bytes_is_damage(database: Path) -> None:
    change(database, "UPDATE messages SET data = 'text' WHERE id = 1")
    with pytest.raises(RecordingError, match=r"after 2 messages \(log time 30 ns\).*message 1 has no bytes"):
        stamps(database)


def test_messages_of_an_unlisted_topic_are_counted(database: Path) -> None:
    change(database, "UPDATE messages SET topic_id = 9 WHERE id = 1")
    with pytest.raises(RecordingError, match=r"messages of a topic that the file does not list \(1 messages\)"):
        stamps(database)


def test_what_the_recorder_left_in_its_journal_is_not_lost_in_silence(database: Path) -> None:
    database.with_name("rec.db3-wal").write_bytes(b"rows to come")
    with pytest.raises(RecordingError, match="the recorder did not close it"):
        open_recording([database], ReadOptions("none"))
