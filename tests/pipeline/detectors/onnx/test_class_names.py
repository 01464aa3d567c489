from pathlib import Path

import pytest

from lidcam.pipeline.core.errors import ConfigError, ModelError
from lidcam.pipeline.detectors.onnx.class_names import COCO_LABELS, class_names


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        ("{1: 'person', 0: 'car'}", ("car", "person")),
        ("{0: \"driver's mate\", 1: 'señor, or: {else}'}", ("driver's mate", "señor, or: {else}")),
        ('["car", "person"]', ("car", "person")),
        ('{"0": "car", "1": "person"}', ("car", "person")),
    ],
)
def test_names_of_the_networks_own_file(metadata: str, expected: tuple[str, ...]) -> None:
    assert class_names("", {"names": metadata}, 2) == class_names("", {"names": metadata}, None) == expected


@pytest.mark.parametrize(
    "metadata",
    [
        "",
        "car",
        "{0: 'car', 2: 'person'}",
        "{-1: 'car'}",
        "{0: no}",
        "{}",
        "[]",
        "[",
        "{" * 5000,
        "\x00",
        "'" + "a" * (1 << 21),
    ],
)
def test_names_that_cannot_be_read(metadata: str) -> None:
    with pytest.raises(ModelError, match=r"cannot be read: set detect2d\.names") as caught:
        class_names("", {"names": metadata}, 2)
    assert "\n" not in str(caught.value)


def test_without_names_80_classes_are_those_of_coco() -> None:
    assert class_names("", {}, 80) is COCO_LABELS
    assert class_names("coco", {}, None) is COCO_LABELS
    assert class_names("coco", {"names": "{0: 'car'}"}, 80) is COCO_LABELS


@pytest.mark.parametrize(
    ("wanted", "metadata", "count", "message"),
    [
        ("", {}, None, r"does not say how many.*: set detect2d\.names to a file"),
        ("", {}, 3, r"has 3 classes.*: set detect2d\.names to a file"),
        ("", {"names": "{0: 'car'}"}, 3, "the network has 3 classes, and its file has 1 names"),
        ("coco", {}, 3, r"the network has 3 classes, and detect2d.names \(coco\) has 80 names"),
    ],
)
def test_names_and_classes_must_be_as_many(
    wanted: str, metadata: dict[str, str], count: int | None, message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        class_names(wanted, metadata, count)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.txt", "car\n person \n\ntram\n\n\n"),
        ("a.names", "\ufeffcar\r\nperson\r\n\r\ntram"),  # as editors of Windows write it
        ("a.yaml", "path: x\nnames:\n  0: car\n  1: person\n  2: ''\n  3: tram\n"),
        ("a.yml", "names: [car, person, '', tram]\n"),
        ("config.json", '{"id2label": {"0": "car", "1": "person", "2": "", "3": "tram"}, "label2id": {}}'),
    ],
)
def test_names_from_files(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text, newline="")
    assert class_names(str(path), {"names": "{0: 'x'}"}, 4) == ("car", "person", "", "tram")


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.txt", b"", "it holds none"),
        ("a.txt", b"\xff\xfe", "it holds none"),
        ("a.txt", b"a\n" * (1 << 20), "expected at most 1"),
        ("a.yaml", b"names: 3", "it holds none"),
        ("a.yaml", b"[" * 100, "it holds none"),
        ("a.json", b"{", "it holds none"),
        ("a.txt", None, "No such file"),
        (".", None, "Is a directory"),
    ],
)
def test_files_without_names(tmp_path: Path, name: str, data: bytes | None, reason: str) -> None:
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(ConfigError, match=rf"detect2d\.names: .*expected names of classes: {reason}"):
        class_names(str(tmp_path / name), {}, 4)
