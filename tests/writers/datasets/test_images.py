"""COCO's own library and the rules of Ultralytics's layout judge the formats of images."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lidcam.writers.datasets.images import (
    CocoWriter,
    ImageLabels,
    ImageWriter,
    LabelledFrame,
    LabelledImage,
    YoloWriter,
)

CLASSES = ("car", "bus")
TRUE, FOUND = (40.0, 20.0, 140.0, 80.0), (50.0, 20.0, 140.0, 80.0)


def labels(*boxes: tuple[float, float, float, float], score: float = 1.0, name: str = "bus") -> ImageLabels:
    n, xyxy = len(boxes), np.array(boxes, np.float32).reshape(-1, 4)
    return ImageLabels(np.full(n, name), xyxy, np.full(n, score, np.float32), np.arange(n) - 1, np.full(n, "both"))


def image(number: int, found: ImageLabels, truth: ImageLabels | None = None, *, is_late: bool = False) -> LabelledImage:
    return LabelledImage(
        f"drive_front_{number:06d}", "front", number, number, b"\xff\xd8", ".jpg", 200, 100, found, truth, is_late
    )


def written(writer: ImageWriter, *images: LabelledImage) -> None:
    writer.begin(CLASSES)
    for one in images:
        writer.add_frame(LabelledFrame(one.stamp_ns, (one,)))
    writer.finish()


def test_cocos_library_evaluates_results_by_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="needs pycocotools, which judges COCO's format")
    evaluation = pytest.importorskip("pycocotools.cocoeval")
    right = image(1, labels(TRUE, score=0.8), labels(TRUE))
    narrow = image(2, labels(FOUND, score=0.7), labels(TRUE))
    written(writer := CocoWriter(tmp_path), right, narrow, image(3, labels(), labels()))
    truth = coco.COCO(str(tmp_path / "annotations" / "instances.json"))
    run = evaluation.COCOeval(truth, truth.loadRes(str(tmp_path / "results.json")), "bbox")
    run.evaluate(), run.accumulate(), run.summarize()
    capsys.readouterr()
    # 0.9 of the second box is right: of ten limits, one is above
    assert run.stats[:2] == pytest.approx([0.95, 1.0], abs=0.03)
    assert [one["name"] for one in truth.loadCats(truth.getCatIds())] == list(CLASSES)
    assert writer.written == {"frames": 3, "images": 3, "boxes": 2}


def test_coco_boxes_are_corner_and_size(tmp_path: Path) -> None:
    written(CocoWriter(tmp_path), image(1, labels(TRUE, TRUE, score=0.25)))
    content = json.loads((tmp_path / "annotations" / "instances.json").read_text())
    first, second = content["annotations"]
    box: Any = {"id": 1, "image_id": 1, "category_id": 2, "bbox": [40, 20, 100, 60], "area": 6000, "iscrowd": 0}
    assert first == box | {"score": 0.25, "origin": "both"}
    assert second["track_id"] == 1
    (shown,) = content["images"]
    assert (tmp_path / "images" / shown["file_name"]).read_bytes() == b"\xff\xd8"
    assert (shown["width"], shown["height"]) == (200, 100)


def test_coco_numbers_tracks_over_all_scenes(tmp_path: Path) -> None:
    """Those of a truth may be hashes, which JSON's numbers do not hold."""
    writer = CocoWriter(tmp_path)
    for number in (1, 2):
        writer.begin(CLASSES)
        many = replace(labels(TRUE, FOUND), tracks=np.array([2**62 + 1, 7]))
        for index in (0, 1):
            one = image(10 * number + index, many)
            writer.add_frame(LabelledFrame(one.stamp_ns, (one,)))
    writer.finish()
    content = json.loads((tmp_path / "annotations" / "instances.json").read_text())
    assert [one["track_id"] for one in content["annotations"]] == [1, 2, 1, 2, 3, 4, 3, 4]


def test_no_image_replaces_another(tmp_path: Path) -> None:
    with pytest.raises(FileExistsError):
        written(CocoWriter(tmp_path), image(1, labels(TRUE)), image(1, labels(FOUND)))


def test_yolo_lines_are_shares_of_the_image(tmp_path: Path) -> None:
    early, late = image(1, labels(TRUE), labels(FOUND, name="car")), image(2, labels(TRUE), is_late=True)
    written(YoloWriter(tmp_path), early, late, image(3, labels(), is_late=True))
    data = yaml.safe_load((tmp_path / "data.yaml").read_text())
    assert data["names"] == {0: "car", 1: "bus"}
    images = {part: sorted((tmp_path / data[part]).iterdir()) for part in ("train", "val")}
    assert {part: len(paths) for part, paths in images.items()} == {"train": 1, "val": 2}
    # Ultralytics finds the labels of an image by these names
    of_images = [
        Path(str(path).replace("/images/", "/labels/")).with_suffix(".txt").read_text()
        for path in (*images["train"], *images["val"])
    ]
    assert of_images == ["0 0.475000 0.500000 0.450000 0.600000\n", "1 0.450000 0.500000 0.500000 0.600000\n", ""]


def test_yolo_without_a_part_is_told(tmp_path: Path) -> None:
    written(writer := YoloWriter(tmp_path), image(1, labels(TRUE)))
    assert writer.remarks == ["no images in images/val: the results are too short to be shared out"]


def test_results_with_other_classes_share_a_numbering(tmp_path: Path) -> None:
    writer = YoloWriter(tmp_path)
    writer.begin(CLASSES)
    written(writer, image(1, labels(TRUE)))
    writer.begin(("tram", "bus"))
    writer.finish()
    assert yaml.safe_load((tmp_path / "data.yaml").read_text())["names"] == {0: "car", 1: "bus", 2: "tram"}
