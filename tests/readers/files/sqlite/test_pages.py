"""Write-ahead logs and rollback journals, from which SQLite completes a database."""

import sqlite3
from contextlib import closing
from pathlib import Path

from sound_recordings import read_all, sound_recording, write_files

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
