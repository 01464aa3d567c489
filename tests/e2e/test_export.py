"""Results as data sets, through the command; `benchmarks/nuscenes_kit.py` asks nuScenes's own kit about them."""

import json
from pathlib import Path

import pytest
from command import Lidcam
from helpers import CLUSTERS, CROSSING

from lidcam.readers.open import open_recording


@pytest.mark.parametrize("name", ["kitti", "kitti-tracking", "nuscenes", "coco", "yolo", "cvat"])
def test_every_format_is_written_and_nothing_is_replaced(
    lidcam: Lidcam, first_result: Path, tmp_path: Path, name: str
) -> None:
    command = ("export", first_result, "--format", name, "--out", tmp_path / "set", "--every", 2)
    done = lidcam(*command)
    assert done.code == 0, done.err
    assert done.err.splitlines()[-1].startswith(f"wrote {tmp_path / 'set'}: 3 frames, ")
    before = sorted(tmp_path.rglob("*"))
    assert "exists and is not empty" in lidcam(*command).error_line
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("kitti", "--camera", "cam99"), "out: expected a camera with images, cam11, "),
        (("coco", "--camera", "cam99"), "out.mcap: expected a camera with images, cam11, "),
        (("cvat", "--camera", "cam11"), "camera: cvat has all cameras; only kitti, kitti-tracking, coco"),
        (("kitti", "--truth", "missing.json"), "missing.json: no such file or folder"),
    ],
)
def test_what_cannot_be_exported_leaves_nothing(
    lidcam: Lidcam, first_result: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    done = lidcam("export", first_result, "--out", tmp_path / "set", "--format", *arguments)
    assert done.code == 1
    assert said in done.error_line
    assert not [*tmp_path.iterdir()]


def test_results_without_clouds_or_of_one_name_are_told(lidcam: Lidcam, first_result: Path, tmp_path: Path) -> None:
    less = ("--set", "output.clouds=false", "--set", "output.images=false", "--set", CLUSTERS)
    part = ("--duration", 0.2, "--config", "sandbox")
    poor = tmp_path / "poor.mcap"
    assert lidcam("process", first_result.with_name("first.bag"), poor, *less, *part).code == 0
    done = lidcam("export", poor, "--format", "nuscenes", "--out", tmp_path / "set")
    assert done.error_line.endswith("found none: process the recording again with output.clouds=true")
    twice = lidcam("export", poor, poor, "--format", "nuscenes", "--out", tmp_path / "other")
    assert twice.error_line.endswith("expected results of different names, found two called poor")


def test_images_are_written_as_recorded_with_true_boxes(lidcam: Lidcam, tmp_path: Path) -> None:
    result, folder = tmp_path / "out.mcap", tmp_path / "set"
    assert lidcam("process", CROSSING, result, "--duration", 0.5, "--set", CLUSTERS).code == 0
    one = ("--camera", "camera_north_west")
    done = lidcam("export", result, "--format", "coco", "--out", folder, *one)
    content = json.loads((folder / "annotations/instances.json").read_text(encoding="utf-8"))
    boxes = len(content["annotations"])
    assert done.err.splitlines()[-1] == f"wrote {folder}: 2 frames, 2 images, {boxes} ground-truth boxes"
    assert "has no images" not in done.err, "of cameras that were not asked for"
    with open_recording([CROSSING]) as recording:
        messages = [*recording.messages(["/camera_north_west/image_raw/compressed"])]
    names = sorted(path.name for path in (folder / "images").iterdir())
    assert [one["file_name"] for one in content["images"]] == names
    for shown in content["images"]:
        (message,) = (one for one in messages if one.stamp_ns == shown["stamp_ns"])
        assert (folder / "images" / shown["file_name"]).read_bytes() in bytes(message.data)
    assert {box["origin"] for box in content["annotations"]} == {"truth"}
    found = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    agreed = lidcam("export", result, "--format", "coco", "--out", tmp_path / "agreed", "--only", "confirmed")
    assert agreed.code == 0
    both = json.loads((tmp_path / "agreed" / "results.json").read_text(encoding="utf-8"))
    assert len(both) > len(found) > 5, "of all cameras"
    done = lidcam("export", result, "--format", "kitti", "--out", tmp_path / "kitti")
    assert "true objects of class bus, which kitti does not have" in done.err
    lines = (tmp_path / "kitti/training/label_2/000000.txt").read_text(encoding="utf-8").splitlines()
    assert "Van" in {line.split()[0] for line in lines}
