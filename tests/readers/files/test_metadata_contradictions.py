"""A ROS 2 bag folder whose metadata.yaml and files contradict one another."""

from pathlib import Path

import pytest
from sound_recordings import read_all, sound_recording, write_files

from lidcam.pipeline.core.errors import RecordingError

SOUND = sound_recording("folder-sqlite")


@pytest.mark.parametrize(
    ("old", "new", "missing"),
    [
        (b"message_count: 45", b"message_count: 48", 3),
        (b"message_count: 45", b"message_count: 44", 0),
        (b"message_count: 45", b"message_count: many", None),
        (b"message_count: 45", b"message_cont: 45", None),
        (b"name: /odom", b"name: /odon", None),
    ],
)
def test_counts_of_metadata_and_file(tmp_path: Path, old: bytes, new: bytes, missing: int | None) -> None:
    metadata = SOUND.files["metadata.yaml"].replace(old, new)
    folder = write_files(tmp_path, SOUND, {**SOUND.files, "metadata.yaml": metadata})
    messages, losses = read_all(folder, "as_needed")
    assert messages == SOUND.messages
    assert [loss.messages for loss in losses] == ([] if missing is None else [missing])
    assert all("messages, the file has 45" in loss.reason for loss in losses)
    if missing is not None:
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
