"""Write-ahead logs and rollback journals that SQLite does not apply, which it does not say."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from sound_recordings import read_all, sound_recording, write_files

WAL = sound_recording("sqlite-wal")
PAGE = 4096
FRAME = PAGE + 24


def reasons(tmp_path: Path, wal: bytes) -> tuple[int, list[str]]:
    path = write_files(tmp_path, WAL, {**WAL.files, "rec.db3-wal": wal})
    messages, losses = read_all(path, "as_needed")
    return len(messages), [loss.reason for loss in losses if loss.reason not in WAL.told]


def test_a_sound_log_is_applied(tmp_path: Path) -> None:
    assert reasons(tmp_path, WAL.files["rec.db3-wal"]) == (len(WAL.messages), [])


@pytest.mark.parametrize("place", [0, 4, 8, 16, 24, 32 + FRAME, 32 + FRAME + 4, 32 + FRAME + 8, 32 + FRAME + 100])
def test_a_changed_bit_in_a_log_is_told(tmp_path: Path, place: int) -> None:
    altered = bytearray(WAL.files["rec.db3-wal"])
    altered[place] ^= 1
    count, (told,) = reasons(tmp_path, bytes(altered))
    assert count < len(WAL.messages)
    assert "pages of rec.db3-wal cannot be applied" in told


def test_an_incomplete_last_page_is_told(tmp_path: Path) -> None:
    count, (told,) = reasons(tmp_path, WAL.files["rec.db3-wal"][: 32 + 3 * FRAME + 50])
    assert count < len(WAL.messages)
    assert "2 pages of rec.db3-wal cannot be applied" in told


@pytest.mark.parametrize(("size", "pages"), [(10, 0), (32, 0), (32 + FRAME, 1)])
def test_a_log_that_ends_early(tmp_path: Path, size: int, pages: int) -> None:
    """A recorder that was killed leaves the same: pages that were not committed are not applied."""
    count, told = reasons(tmp_path, WAL.files["rec.db3-wal"][:size])
    assert count < len(WAL.messages)
    assert [reason.startswith(f"{pages} pages of") for reason in told] == [True] * pages


def test_pages_of_an_older_log_are_not_missed(tmp_path: Path) -> None:
    """SQLite writes a log anew from its beginning, and does not cut it."""
    wal = WAL.files["rec.db3-wal"]
    last = bytearray(wal[-FRAME:])
    last[8:16] = bytes(8)
    assert reasons(tmp_path, wal + bytes(last)) == (len(WAL.messages), [])


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


def test_a_journal_that_is_damaged_is_told(tmp_path: Path) -> None:
    path, journal = half_written(tmp_path)
    path.with_name("rec.db3-journal").write_bytes(b"\xd8" + journal[1:])
    _, losses = read_all(path, "as_needed")
    assert any("rec.db3-journal cannot be applied" in loss.reason for loss in losses)


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
