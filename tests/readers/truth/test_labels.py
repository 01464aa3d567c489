import json
from pathlib import Path

import pytest
from frames import RIG

from pipeline.core.errors import RecordingError
from pipeline.core.settings.config import Config
from readers.truth.boxes import read_label_text
from readers.truth.kitti import KittiTruth
from readers.truth.open import open_labels
from readers.truth.openlabel import OpenLabelTruth
from readers.truth.predecessor import PredecessorTruth
from readers.truth.source import TruthSource

RIG = type(RIG)(RIG.site_frame, RIG.lidars[:1], RIG.cameras, RIG.zones)
CAR = "Car 0.10 1 -1.57 500.0 150.0 600.0 220.0 1.50 1.80 4.20 2.0 1.6 20.0 -1.570796"
OPENLABEL = json.dumps({"openlabel": {"frames": {"0": {}}}})
BAGS = Path(__file__).parents[3] / "bags"


def opened(path: Path) -> TruthSource | None:
    return open_labels(path, RIG, Config())


@pytest.mark.parametrize(
    ("files", "given", "kind"),
    [
        ({"a.txt": CAR}, "a.txt", KittiTruth),
        ({"label_2/000001.txt": CAR}, "", KittiTruth),
        ({"label_2/000001.txt": CAR}, "label_2", KittiTruth),
        ({"labels": OPENLABEL}, "labels", OpenLabelTruth),
        ({"1.json": OPENLABEL, "2.json": OPENLABEL}, "", OpenLabelTruth),
        ({"odom/30000.txt": "1 2 3", "pcd/0.txt": ""}, "", PredecessorTruth),
    ],
)
def test_the_content_says_what_it_is(tmp_path: Path, files: dict[str, str], given: str, kind: type) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert isinstance(opened(tmp_path / given), kind)


def test_recordings_are_for_others_to_open(tmp_path: Path) -> None:
    (tmp_path / "drive.db3").write_text("")
    for path in (BAGS / "sandbox.bag", BAGS / "crossing.mcap", tmp_path):
        assert opened(path) is None


@pytest.mark.parametrize(
    ("files", "given", "problem"),
    [
        ({}, "none", "none: no such file or folder; expected truth: a recording, a result, KITTI's labels"),
        ({"a.txt": "hello"}, "a.txt", "found a file of another kind"),
        ({"a.txt": ""}, "a.txt", "found a file of another kind"),
        ({}, "", "found an empty folder"),
        ({"a.png": "", "b.png": ""}, "", "found a folder with a.png, b.png"),
    ],
)
def test_what_is_no_truth(tmp_path: Path, files: dict[str, str], given: str, problem: str) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError) as caught:
        opened(tmp_path / given)
    assert problem in str(caught.value)


def test_a_file_that_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.txt").write_text(CAR)

    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)
    for read in (opened, lambda path: read_label_text(path, 10)):
        with pytest.raises(RecordingError, match=r"a\.txt: cannot be read: Permission denied"):
            read(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "no such file"),
        (b"\xff\xfe", "expected labels as UTF-8 text, found other bytes at 0"),
        (b"x" * 11, "expected labels of at most 0 MiB, found a larger file"),
    ],
)
def test_labels_that_cannot_be_read(tmp_path: Path, content: bytes | None, problem: str) -> None:
    if content is not None:
        (tmp_path / "a.txt").write_bytes(content)
    with pytest.raises(RecordingError, match=rf"a\.txt: {problem}"):
        read_label_text(tmp_path / "a.txt", 10)
