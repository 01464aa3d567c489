"""Frames are measured in one pass, and the names of figures are known before it."""

from evaluation_frames import frame_of, rows_at, source_boxes, truth_boxes

from lidcam.evaluation.evaluators import evaluators_of, known_figures, measure
from lidcam.evaluation.figures import NamedFigures
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config

RIG = Rig("site", (), (), ())


def fixed(figures: NamedFigures) -> list[str]:
    """The names that depend neither on the words of the truth, nor on the length of a result, nor on its mistakes."""
    names = [name for name in figures if ".labels." not in name and ".over_time." not in name]
    return [name for name in names if not name.startswith("mistakes.")]


def test_frames_are_read_once() -> None:
    frames = (frame_of(k, truth_boxes(rows_at([(5, 0)])), {"fused": source_boxes(rows_at([(5, 0)]))}) for k in range(3))
    tree = measure(frames, evaluators_of(Config(), RIG))
    assert tree["frames"] == 3


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
    found = NamedFigures(measure(frames, evaluators_of(Config(), RIG)))
    assert fixed(found) == fixed(known)
