import shutil
from pathlib import Path

import pytest
from builders import odometry, raw, write_rosbag2
from sound_recordings import read_all, sound_recording, write_files

from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.files.rosbag2_folder import FolderMetadata, folder_metadata, recording_files
from lidcam.readers.open import open_recording

T0 = 1_700_000_000 * 10**9


def split_folder(tmp_path: Path, parts: int) -> Path:
    """A folder without metadata.yaml; every part one message, all with the same log time."""
    folder = tmp_path / "rec"
    folder.mkdir()
    for i in range(parts):
        message = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=T0 + i), T0 + i, T0)
        write_rosbag2(tmp_path / f"part{i}", [message])
        shutil.move(tmp_path / f"part{i}" / f"part{i}.db3", folder / f"rec_{i}.db3")
    return folder


def test_folder_without_metadata_in_the_order_of_the_numbers(tmp_path: Path) -> None:
    folder = split_folder(tmp_path, 12)
    assert [file.name for file in recording_files(folder)] == [f"rec_{i}.db3" for i in range(12)]
    with open_recording([folder]) as recording:
        assert [m.stamp_ns - T0 for m in recording.messages()] == [*range(12)]


@pytest.mark.parametrize("prefix", ["", "rec/"])  # rosbag2 before version 4 wrote the folder's name as well
def test_metadata_gives_files_order_and_release(tmp_path: Path, prefix: str) -> None:
    folder = split_folder(tmp_path, 3)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  ros_distro: humble\n  compression_mode: ''\n"
        f"  relative_file_paths: [{prefix}rec_2.db3, {prefix}rec_0.db3]\n"
    )
    assert folder_metadata(folder) == FolderMetadata(("rec_2.db3", "rec_0.db3"), False, "humble")
    with open_recording([folder]) as recording:
        assert [m.stamp_ns - T0 for m in recording.messages()] == [2, 0]


@pytest.mark.parametrize(
    ("file", "text", "fault"),
    [
        ("rec_0.mcap", "", "found several kinds of files"),
        ("metadata.yaml", "relative_file_paths: [rec_0.db3, rec_7.db3]", r"lists rec_7\.db3, which is not there"),
        (
            "metadata.yaml",
            "relative_file_paths: [], compression_mode: FILE, compression_format: fake",
            "expected compression zstd, found 'fake'",
        ),
    ],
)
def test_folders_that_cannot_be_read(tmp_path: Path, file: str, text: str, fault: str) -> None:
    folder = split_folder(tmp_path, 1)
    (folder / file).write_text(f"rosbag2_bagfile_information: {{{text}}}")
    with pytest.raises(RecordingError, match=fault):
        open_recording([folder])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a: [",
        "- 1",
        "rosbag2_bagfile_information: {}",
        "rosbag2_bagfile_information: {relative_file_paths: 3}",
        "\0",
    ],
)
def test_unreadable_metadata(tmp_path: Path, text: str) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(RecordingError, match=r"metadata\.yaml: expected rosbag2's metadata") as caught:
        open_recording([tmp_path])
    assert "\n" not in str(caught.value)
    assert not any(name in str(caught.value) for name in ("TypeError", "KeyError", "AttributeError"))


def test_a_file_by_itself_beside_somebody_elses_metadata(tmp_path: Path) -> None:
    file = split_folder(tmp_path, 1) / "rec_0.db3"
    (file.parent / "metadata.yaml").write_text("name: my dataset")
    with open_recording([file]) as recording:
        assert recording.message_count == 1
    with pytest.raises(RecordingError, match="expected rosbag2's metadata"):
        open_recording([file.parent])


def test_files_that_metadata_does_not_list_are_told(tmp_path: Path) -> None:
    sound = sound_recording("folder-sqlite")
    more = {"rec_1.db3": sound.files["rec.db3"], "rec.db3.zstd": b"packed twin", "notes.txt": b""}
    folder = write_files(tmp_path, sound, {**sound.files, **more})
    messages, (loss,) = read_all(folder, "as_needed")
    assert messages == sound.messages
    assert (loss.path, loss.size, loss.messages) == (folder / "rec_1.db3", len(sound.files["rec.db3"]), None)
    assert "does not list this file" in loss.reason
    with pytest.raises(RecordingError, match=r"rec_1\.db3: .*does not list"):
        read_all(folder, "none")
