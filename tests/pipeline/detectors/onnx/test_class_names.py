from pathlib import Path

import pytest

from lidcam.pipeline.core.errors import ConfigError, ModelError
from lidcam.pipeline.detectors.onnx.class_names import COCO_LABELS, class_names


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        ("{0: 'car', 1: 'person'}", ("car", "person")),
        ("{1: 'person', 0: 'car'}", ("car", "person")),
        ("{0: \"driver's mate\", 1: 'señor, or: {else}'}", ("driver's mate", "señor, or: {else}")),
        ('["car", "person"]', ("car", "person")),
        ('{"0": "car", "1": "person"}', ("car", "person")),
    ],
)
def test_names_of_the_networks_own_file(metadata: str, expected: tuple[str, ...]) -> None:
    assert class_names("", {"names": metadata}, 2) == expected
    assert class_names("", {"names": metadata}, None) == expected


@pytest.mark.parametrize(
    "metadata",
    [
        "",
        "car",
        "{0: 'car', 2: 'person'}",
        "{-1: 'car'}",
        "{0: 1}",
        "{0: no}",
        "{}",
        "[]",
        "[",
        "{" * 5000,
        "[" * 5000,
        "'" + "a" * (1 << 21),
        "__import__('os').abort()",
        "{0: !!python/object:os.abort {}}",
        "\x00",
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


@pytest.mark.parametrize(("count", "told"), [(None, "does not say how many"), (3, "has 3 classes"), (91, "has 91")])
def test_no_names_say_what_to_do(count: int | None, told: str) -> None:
    with pytest.raises(ModelError, match=rf"{told}.*: set detect2d\.names to a file"):
        class_names("", {}, count)


def test_names_and_classes_must_be_as_many() -> None:
    with pytest.raises(ModelError, match="the network has 3 classes, and its file has 1 names"):
        class_names("", {"names": "{0: 'car'}"}, 3)
    with pytest.raises(ModelError, match=r"the network has 3 classes, and detect2d.names \(coco\) has 80 names"):
        class_names("coco", {}, 3)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.txt", "car\n person \n\ntram\n\n\n"),
        ("a.names", "car\r\nperson\r\n\r\ntram"),
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
    ("name", "data"),
    [
        ("a.txt", b""),
        ("a.txt", b"\n\n"),
        ("a.txt", b"\xff\xfe"),
        ("a.txt", b"a\n" * (1 << 20)),
        ("a.yaml", b"names: 3"),
        ("a.yaml", b"[" * 100),
        ("a.json", b"{"),
        ("a.json", b""),
    ],
)
def test_files_without_names(tmp_path: Path, name: str, data: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(
        ConfigError, match=r"detect2d\.names: .*expected names of classes: (it holds none|expected at most 1)"
    ):
        class_names(str(path), {}, 4)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"expected names of classes: No such file"):
        class_names(str(tmp_path / "a.txt"), {}, 4)
    with pytest.raises(ConfigError, match=r"expected names of classes: Is a directory"):
        class_names(str(tmp_path), {}, 4)
