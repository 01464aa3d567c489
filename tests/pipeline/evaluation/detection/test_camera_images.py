"""2D boxes against what the images show."""

from typing import Any

import pytest
from evaluation_frames import evaluated, image, truth2d

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, ImageBoxes

CAR, PEDESTRIAN = 0, 1
CONFIG = Config()
BOX = (100.0, 100.0, 200.0, 150.0)


def figures(*images: ImageBoxes) -> Any:
    frames = [EvaluationFrame(row, row, None, {}, {"cam": shown}) for row, shown in enumerate(images)]
    return evaluated(frames, CONFIG)["images"]["cam"]


def counts(tree: Any) -> dict[str, int]:
    names = ("truth", "truth_ignored", "found", "right", "missed", "false", "ignored")
    return {name: tree[name] for name in names if tree[name]}


def moved(right_px: float, down_px: float = 0.0) -> tuple[float, ...]:
    return (BOX[0] + right_px, BOX[1] + down_px, BOX[2] + right_px, BOX[3] + down_px)


@pytest.mark.parametrize(("right_px", "is_right"), [(0, 1), (33, 1), (34, 0)], ids=["all", "IoU 67 / 133", "66 / 134"])
def test_half_an_overlap_is_right(right_px: float, is_right: int) -> None:
    tree = figures(image(moved(right_px), [0.9], [CAR], truth2d(BOX, [CAR])))["car"]
    assert (tree["right"], tree["false"], tree["false_per_image"]) == (is_right, 1 - is_right, 1 - is_right)
    assert tree["ap_2d_r40_50"] == is_right


@pytest.mark.parametrize("columns", [{"is_ignored": True}, {"image_pixels": 0}, {"class_ids": [UNKNOWN]}])
def test_what_is_ignored_is_neither_missed_nor_an_error(columns: dict[str, Any]) -> None:
    shown = truth2d(BOX, columns.pop("class_ids", [CAR]), **columns)
    both = [*moved(5), *moved(-5)]
    tree = figures(image(both, [0.9, 0.8], [CAR, PEDESTRIAN], shown))["all"]
    assert counts(tree) == {"truth_ignored": 1, "found": 2, "ignored": 2}
    assert counts(figures(image([], [], [], shown))["all"]) == {"truth_ignored": 1}


@pytest.mark.parametrize("pixels", [1, UNKNOWN])
def test_enough_pixels_or_no_count_of_them(pixels: int) -> None:
    tree = figures(image([], [], [], truth2d(BOX, [CAR], image_pixels=pixels)))["car"]
    assert counts(tree) == {"truth": 1, "missed": 1}


def test_a_region_that_nobody_labelled_holds_many() -> None:
    region = truth2d([0, 0, 1000, 1000], [UNKNOWN], is_ignored=True)
    tree = figures(image([*BOX, *moved(300), *moved(960)], [0.9, 0.8, 0.7], [CAR, CAR, CAR], region))["car"]
    assert counts(tree) == {"found": 3, "ignored": 2, "false": 1}  # the last one reaches out of it


def test_images_without_truth_are_counted_and_not_evaluated() -> None:
    tree = figures(image(BOX, [0.9], [CAR], None), image(moved(500), [0.9], [CAR], truth2d([], [])))
    for name in ("car", "all"):
        assert (tree[name]["images"], tree[name]["images_without_truth"], tree[name]["false"]) == (1, 1, 1)
        assert tree[name]["false_per_image"] == 1.0
    tree = figures(image(BOX, [0.9], [CAR], None))["car"]
    assert (tree["images"], tree["images_without_truth"], tree["precision"]) == (0, 1, None)


def test_boxes_without_extent_overlap_nothing() -> None:
    nothing = (150.0, 120.0, 150.0, 120.0)
    tree = figures(image(nothing, [0.9], [CAR], truth2d(nothing, [CAR])))["car"]
    assert counts(tree) == {"truth": 1, "found": 1, "missed": 1, "false": 1}
