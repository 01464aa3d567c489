"""A ROS 2 bag folder whose metadata.yaml and files contradict one another."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from sound_recordings import read_all, sound_recording, write_files

from pipeline.core.errors import RecordingError

SOUND = sound_recording("folder-sqlite")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (b"name: /odom", b"name: /odon", "does not list topic '/odom' of type 'nav_msgs/msg/Odometry'"),
        (b"type: nav_msgs/msg/Odometry", b"type: nav_msgs/msg/Odometrx", "does not list topic '/odom'"),
        (b"message_count: 45\n    path", b"message_count: 44\n    path", ""),  # contradicts itself
        (b"message_count: 45\n  rel", b"message_count: 55\n  rel", ""),
        (b"message_count: 45", b"message_count: many", ""),
        (b"topics_with_message_count", b"topics_with_message_cont", ""),
        (b"version: 9", b"version: 8", ""),
    ],
)
def test_altered_metadata(tmp_path: Path, old: bytes, new: bytes, told: str) -> None:
    metadata = SOUND.files["metadata.yaml"].replace(old, new)
    messages, losses = read_all(write_files(tmp_path, SOUND, {**SOUND.files, "metadata.yaml": metadata}), "as_needed")
    assert messages == SOUND.messages
    assert [loss.messages for loss in losses] == [0] * bool(told)
    assert told in "".join(loss.reason for loss in losses)


@pytest.mark.parametrize(
    ("statement", "told", "missing"),
    [
        ("UPDATE topics SET name = '/ndom' WHERE name = '/odom'", "does not list topic '/ndom'", 0),
        ("DELETE FROM messages WHERE id = 1", "says 24 messages of '/odom', the file has 23", 1),
        ("UPDATE messages SET topic_id = 2 WHERE id = 1", "says 6 messages of '/image', the file has 7", 0),
    ],
)
def test_altered_files(tmp_path: Path, statement: str, told: str, missing: int) -> None:
    folder = write_files(tmp_path, SOUND, SOUND.files)
    with closing(sqlite3.connect(folder / "rec.db3")) as database, database:
        database.execute(statement)
    _, (loss,) = read_all(folder, "as_needed")
    assert told in loss.reason
    assert loss.messages == missing
    with pytest.raises(RecordingError, match=r"metadata\.yaml"):
        read_all(folder, "none")


def test_files_that_metadata_does_not_list_are_told(tmp_path: Path) -> None:
    more = {"rec_1.db3": SOUND.files["rec.db3"], "rec.db3.zstd": b"packed twin", "notes.txt": b""}
    folder = write_files(tmp_path, SOUND, {**SOUND.files, **more})
    messages, (loss,) = read_all(folder, "as_needed")
    assert messages == SOUND.messages
    assert (loss.path, loss.size, loss.messages) == (folder / "rec_1.db3", len(SOUND.files["rec.db3"]), None)
    assert "does not list this file" in loss.reason
    with pytest.raises(RecordingError, match=r"rec_1\.db3: .*does not list"):
        read_all(folder, "none")
