"""The gain of fusion in the report of an evaluation of made-up frames."""

from io import StringIO

import numpy as np
from evaluation_scenes import boxes3d, truth3d
from rich.console import Console

from lidcam.evaluation.counts import FrameCounts
from lidcam.evaluation.evaluation import Evaluation, Truth
from lidcam.evaluation.figures import NamedFigures, merged
from lidcam.printing.evaluation import print_evaluation
from pipeline.core.settings.config import Config
from pipeline.evaluation.detection.evaluation import DetectionEvaluation
from pipeline.evaluation.records import EvaluationFrame
from readers.input_file import InputFile

SIZE_M = (4.0, 1.7, 1.55)


def report(seconds: int, class_ids: tuple[int, ...] = (0,)) -> list[str]:
    """Fusion finds all cars, and the lidar every second one."""
    n = len(class_ids)
    evaluators = (FrameCounts(Config()), DetectionEvaluation(Config(), ()))
    for index in range(2 * seconds):
        centers = [[10.0 * row, 0.0, 1.0] for row in range(n)]
        truth = truth3d(centers, np.full((n, 3), SIZE_M), np.zeros(n), class_ids)
        found = boxes3d(centers, np.full((n, 3), SIZE_M), np.zeros(n), np.full(n, 0.9), class_ids)
        seen = found.select(np.arange(n * (index % 2)))
        frame = EvaluationFrame(index, index * 500_000_000, truth, {"lidar": seen, "fused": found})
        for evaluator in evaluators:
            evaluator.add(frame)
    figures = NamedFigures(merged([evaluator.figures() for evaluator in evaluators]))
    with StringIO() as out:
        file = InputFile("out.mcap", "out.mcap", 1, "ab" * 32)
        print_evaluation(Console(file=out, width=80), Evaluation(figures, (file,), "", "", Truth(("here",), ())))
        return out.getvalue().splitlines()


def test_gain_with_its_interval() -> None:
    lines = report(20)
    row = lines.index("what fusion adds")
    assert lines[row + 1].split() == ["class", "AP", "bev", "mAP", "F1"]
    assert lines[row + 2].startswith("car    +0.50 (+0.50, +0.50)")
    assert lines[row + 3] == ""  # the only class says it for all
    assert max(map(len, lines[row : row + 3])) <= 80
    assert any("The interval of 95 % comes from" in line for line in lines)


def test_gain_of_several_classes_in_a_short_result() -> None:
    lines = report(2, (0, 0, 4))
    row = lines.index("what fusion adds")
    assert [line.split()[:2] for line in lines[row + 2 : row + 5]] == [
        ["car", "+0.50"],
        ["bus", "+0.50"],
        ["all", "+0.50"],
    ]
