from pathlib import Path

import cv2
import numpy as np
import pytest

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.settings.recording import LimitsConfig
from lidcam.readers.files.evaluation_folder import (
    CAMERAS,
    CLOUD_TOPIC,
    START_NS,
    STEP_NS,
    EvaluationFolder,
    is_evaluation_folder,
)
from lidcam.readers.input_file import read_input_file
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.open import open_recording

LEFT, LAST = "/image_raw_11/compressed", "/image_raw_44/compressed"


def write(folder: Path, numbers: tuple[int, ...] = (0, 1, 2), rows: tuple[int, ...] = (0, 7)) -> Path:
    (folder / "pcd").mkdir(parents=True)
    for number in numbers:
        (folder / "pcd" / f"{number}.txt").write_text(f"{number} 2 3 0.5\n4 5 6 0.25\n")
        (folder / "img" / str(number)).mkdir(parents=True)
        for row in rows:
            cv2.imwrite(str(folder / "img" / str(number) / f"{row}.jpg"), np.full((6, 8, 3), 200, np.uint8))
    return folder


def test_it_is_a_recording(tmp_path: Path) -> None:
    with open_recording([write(tmp_path)]) as recording:
        counts = [(info.topic, info.message_count) for info in recording.topics]
        assert counts == [(LEFT, 3), (LAST, 3), (CLOUD_TOPIC, 3)]
        assert (recording.start_ns, recording.end_ns) == (START_NS, START_NS + 2 * STEP_NS)
        assert (recording.message_count, recording.losses, recording.paths) == (9, (), (tmp_path,))
        messages = list(recording.messages())
    first, second = START_NS, START_NS + STEP_NS
    found = [(m.topic, m.stamp_ns) for m in messages[:4]]
    assert found == [(CLOUD_TOPIC, first), (LEFT, first), (LAST, first), (CLOUD_TOPIC, second)]
    assert sorted(messages, key=lambda m: (m.log_time_ns, m.order)) == messages
    cloud = decode_pointcloud2(messages[3])
    np.testing.assert_array_equal(cloud.xyz, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(cloud.intensity, [0.5, 0.25])
    assert (cloud.frame_id, cloud.stamp_ns) == ("point_cloud", START_NS + STEP_NS)
    image = decode_any_image(messages[1])
    assert image.rgb.shape == (6, 8, 3)


def test_parts_of_it(tmp_path: Path) -> None:
    with open_recording([write(tmp_path, (0, 2, 10))]) as recording:
        found = recording.messages({CLOUD_TOPIC}, start_ns=START_NS + 1, stop_ns=START_NS + 10 * STEP_NS)
        assert [m.stamp_ns for m in found] == [START_NS + 2 * STEP_NS]
        (image,) = recording.messages({LEFT}, start_ns=START_NS + 3 * STEP_NS)
        assert image.stamp_ns == START_NS + 10 * STEP_NS


def test_frames_may_lack_images_or_clouds(tmp_path: Path) -> None:
    folder = write(tmp_path, (0, 1))
    (folder / "img" / "0" / "0.jpg").unlink()
    (folder / "pcd" / "1.txt").unlink()
    (folder / "img" / "1" / "8.jpg").write_bytes(b"the system has eight cameras")
    (folder / "img" / "notes").mkdir()
    with open_recording([folder]) as recording:
        counts = {info.topic: info.message_count for info in recording.topics}
    assert counts == {CLOUD_TOPIC: 1, LEFT: 1, f"/image_raw_{CAMERAS[7]}/compressed": 2}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1 2 3\n", "1.txt cannot be used: expected 4 columns (x y z intensity), found 3"),
        ("1 2 3 4\n1 2\n", "1.txt cannot be used: "),
        ("one two three four\n", "1.txt cannot be used: "),
        ("1 2 3 4\n" * 200_000, "1.txt is too large, see limit_scale"),
    ],
)
def test_clouds_that_are_none(tmp_path: Path, text: str, problem: str) -> None:
    folder = write(tmp_path)
    (folder / "pcd" / "1.txt").write_text(text)
    recording = EvaluationFolder(folder, 0, LimitsConfig(max_message_mib=1))
    clouds = list(recording.messages({CLOUD_TOPIC}, start_ns=None, stop_ns=None))
    assert [bool(message.problem) for message in clouds] == [False, True, False]
    assert clouds[1].problem.startswith(problem)
    assert clouds[1].data == b""


def test_an_empty_cloud_and_commas(tmp_path: Path) -> None:
    folder = write(tmp_path)
    (folder / "pcd" / "0.txt").write_text("\n")
    (folder / "pcd" / "1.txt").write_text("1,2,3,4\n5,6,7,8\n")
    with open_recording([folder]) as recording:
        clouds = [decode_pointcloud2(message) for message in recording.messages({CLOUD_TOPIC})]
    assert [len(cloud.xyz) for cloud in clouds] == [0, 2, 2]


def test_a_file_that_disappears(tmp_path: Path) -> None:
    recording = EvaluationFolder(write(tmp_path), 0, LimitsConfig())
    (tmp_path / "pcd" / "1.txt").unlink()
    messages = list(recording.messages({CLOUD_TOPIC}, start_ns=None, stop_ns=None))
    assert "1.txt cannot be used" in messages[1].problem
    recording.close()


def test_which_folders_are_such(tmp_path: Path) -> None:
    assert not is_evaluation_folder(tmp_path)
    (tmp_path / "pcd").mkdir()
    (tmp_path / "pcd" / "points.txt").write_text("")
    assert not is_evaluation_folder(tmp_path)
    with pytest.raises(RecordingError, match="expected a ROS 2 bag folder"):
        open_recording([tmp_path])
    (tmp_path / "pcd" / "0000000000001.txt").write_text("")
    assert is_evaluation_folder(tmp_path)
    with pytest.raises(RecordingError, match=r"expected clouds pcd/0\.txt, pcd/1\.txt, \.\.\., found none"):
        open_recording([tmp_path])


def test_what_tells_it_from_others(tmp_path: Path) -> None:
    folder = write(tmp_path / "a")
    first = read_input_file(folder)
    assert (first.name, first.bytes) == ("a", None)
    assert first == read_input_file(folder)
    (folder / "pcd" / "2.txt").write_text("1 2 3 4")
    assert read_input_file(folder).sha256 != first.sha256
