"""Frames are measured in one pass, and the names of figures are known before it."""

import json
from collections.abc import Iterator

import numpy as np
import pytest
from detections import boxes2d, camera_rig, forward_camera
from evaluation_frames import frame_of, rows_at, source_boxes, truth_boxes

from lidcam.evaluation.evaluators import FrameCounts, evaluators_of, known_figures, measure, timed
from lidcam.evaluation.figures import NamedFigures
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import SOURCES, EvaluationFrame, ImageBoxes

RIG, RIG_WITH_CAMERA = camera_rig(), camera_rig(forward_camera())


def fixed(figures: NamedFigures) -> list[str]:
    """The names that depend neither on the words of the truth nor on mistakes."""
    names = [name for name in figures if ".labels." not in name]
    return [name for name in names if not name.startswith("mistakes.")]


def test_the_names_of_figures_do_not_depend_on_what_is_found() -> None:
    known = known_figures(Config(), RIG, ["lidar", "fused"])
    frames = [
        frame_of(
            k,
            truth_boxes(rows_at([(5, 0), (9, 9)])),
            {"lidar": source_boxes(rows_at([(5, 0)])), "fused": source_boxes(rows_at([(5, 0), (2, 2)]))},
        )
        for k in range(3)
    ]
    found = NamedFigures({**measure(frames, evaluators_of(Config(), RIG)), **timed(1.5)})
    assert fixed(found) == fixed(known)


def random_frames(seed: int) -> Iterator[EvaluationFrame]:
    """Frames in which truth, sources, images and skew come and go, at times that stand still and step back."""
    random = np.random.default_rng(seed)
    stamp_ns, often = 10**9, random.choice([0, 0.5, 1], 3)
    for index in range(int(random.integers(1, 30))):
        stamp_ns += int(random.choice([10**8, 0, -5 * 10**8, 10**9], p=[0.9, 0.04, 0.02, 0.04]))
        truth, found = (
            np.column_stack(
                [random.normal(0, 8, (n, 3)), random.uniform(0.5, 5, (n, 3)), random.choice([0, np.pi / 2, np.pi], n)]
            )
            for n in random.integers(0, 5, 2)
        )
        shared = min(len(truth), len(found))
        found[:shared, :3] = truth[:shared, :3] + random.choice([0, 0.1], (shared, 3))
        sources = {
            source: source_boxes(
                found,
                random.integers(-1, 4, len(found)).tolist(),
                scores=random.choice([0, 0.25, 0.5, 1], len(found)).tolist(),
                class_ids=random.integers(0, 2, len(found)).tolist(),
            )
            for source in SOURCES
            if random.random() < often[0]
        }
        seen = truth_boxes(
            truth,
            random.integers(-1, 4, len(truth)).tolist(),
            class_ids=random.integers(-1, 2, len(truth)).tolist(),
            lidar_points=random.integers(-1, 3, len(truth)).tolist(),
            image_pixels=random.integers(-1, 3, len(truth)).tolist(),
            is_ignored=(random.random(len(truth)) < 0.2).tolist(),
        )
        image = ImageBoxes(boxes2d([(10, 10, 80, 70, 0.5, 0)] * int(random.integers(0, 3))))
        yield frame_of(
            index,
            seen if random.random() < often[1] else None,
            sources,
            {"cam": image} if random.random() < often[2] else {},
            stamp_ns=stamp_ns,
            skew_ns=None if random.random() < 0.5 else 5,
        )


@pytest.mark.parametrize("seed", range(3))
def test_whatever_comes_the_figures_are_numbers_or_null_and_the_same_again(seed: int) -> None:
    config = Config()
    trees = [measure(random_frames(seed), evaluators_of(config, RIG_WITH_CAMERA)) for _ in range(2)]
    first, second = (json.dumps(tree, allow_nan=False) for tree in trees)
    assert first == second


def test_every_object_is_counted_once_with_the_first_reason() -> None:
    counts = FrameCounts(Config.model_validate({"evaluate": {"max_range_m": 50}}))
    truth = truth_boxes(
        rows_at([(1, 0), (2, 0), (3, 0), (90, 0), (5, 0), (6, 0), (99, 0)]),
        class_ids=[0, -1, 0, 0, 0, 0, -1],
        labels=["car", "tram", "car", "car", "car", "car", "animal"],
        is_ignored=[False, True, True, False, False, False, False],
        lidar_points=[9, 9, 9, 9, 0, 0, 0],
        image_pixels=[0, 0, 9, 0, 0, 5, 0],
    )
    for index, found in enumerate([None, truth, truth, truth_boxes([])]):
        counts.add_frame(frame_of(index, found))
    figures = counts.figures()
    assert (figures["frames"], figures["frames_with_truth"]) == (4, 3)
    assert figures["truth_objects"] == {
        "evaluated": 4,
        "without_class": 4,
        "marked_as_ignored": 2,
        "outside": 2,
        "unseen": 2,
        "labels_without_class": {"animal": 2, "tram": 2},
    }
