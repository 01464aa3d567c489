"""What is printed of an evaluation."""

from collections.abc import Sequence
from io import StringIO
from typing import Any

import pytest
from evaluation_frames import frame_of, rows_at, source_boxes, truth_boxes

from lidcam.cli.printing.evaluation import AP_3D, AP_BEV, mistake_note, print_evaluation, shown_ap
from lidcam.cli.printing.terminal import console
from lidcam.evaluation.evaluation import Evaluation, Truth
from lidcam.evaluation.evaluators import evaluators_of, measure
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.requirement import read_requirements
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame
from lidcam.readers.input_file import InputFile
from lidcam.run.warning import RunWarning

RIG = Rig("site", (), (), ())
CAR_AT, VAN_AT = (5.0, 0.0), (20.0, 5.0)
Place = tuple[float, float]


def frames(
    *,
    lidar: Sequence[Place],
    fused: Sequence[Place],
    truth: Sequence[Place] | None,
    cameras: Sequence[Place] | None = None,
    count: int = 20,
    ids: bool = False,
) -> list[EvaluationFrame]:
    """The same places in every frame: the first of them a car, the others of the second class."""

    def classes(places: Sequence[Place]) -> list[int]:
        return [int(place != CAR_AT) for place in places]

    def found(places: Sequence[Place]) -> Any:
        tracks = list(range(len(places))) if ids else None
        return source_boxes(rows_at(places), tracks, class_ids=classes(places))

    return [
        frame_of(
            k,
            None if truth is None else truth_boxes(rows_at(truth), range(len(truth)), class_ids=classes(truth)),
            {"lidar": found(lidar), "fused": found(fused)} | ({} if cameras is None else {"cameras": found(cameras)}),
        )
        for k in range(count)
    ]


def printed(
    measured: list[EvaluationFrame],
    *,
    requirements: Sequence[str] = (),
    warnings: Sequence[str] = (),
    everything: bool = True,
    **evaluate: Any,
) -> str:
    config = Config.model_validate({"evaluate": evaluate})
    figures = NamedFigures(measure(measured, evaluators_of(config, RIG)))
    has_truth = any(frame.truth is not None for frame in measured)
    evaluation = Evaluation(
        figures,
        (InputFile("a/out.mcap", "out.mcap", 1, "0" * 64),),
        "defaults",
        "0" * 64,
        Truth("/truth of out.mcap", ()) if has_truth else None,
        tuple(requirement.check(figures) for requirement in read_requirements(requirements)),
        tuple(RunWarning("fused", warning, "try this") for warning in warnings),
        ("a note",),
    )
    out = console()
    with StringIO() as text:
        out.file = text
        print_evaluation(out, evaluation, everything=everything)
        return text.getvalue()


def test_the_short_table_is_of_the_result_alone() -> None:
    lines = printed(
        frames(lidar=[], fused=[CAR_AT], truth=[CAR_AT], cameras=[], count=20), everything=False
    ).splitlines()
    assert lines[3].split() == ["fused", "truth", "recall", "prec.", "AP", "bev", "AP", "3D", "position", "heading"]
    assert [line.split()[:4] for line in lines[4:-2]] == [["car", "20", "1.00", "1.00"]]
    assert lines[-2] == "AP at 70 % IoU (pedestrian, bicycle 50 %); mean errors: m, degrees; --all: more"
    assert len(lines[-2]) < 80  # one line on a terminal: with five classes, twelve in all


OVER = "lidar alone"
SHORT = "; too short for a confidence interval."


@pytest.mark.parametrize(
    ("lidar", "fused", "count", "told"),
    [
        ([], [CAR_AT], 20, f"Fusion adds 1.00 AP over {OVER}{SHORT}"),
        ([], [CAR_AT], 60, f"Fusion adds 1.00 AP (+1.00 to +1.00) over {OVER}."),
        ([CAR_AT], [], 60, f"Fusion removes 1.00 AP (-1.00 to -1.00) from {OVER}."),
        ([CAR_AT], [CAR_AT], 60, f"Fusion gains +0.00 AP (+0.00 to +0.00) over {OVER}: not significant."),
    ],
)
def test_the_headline(lidar: list[Place], fused: list[Place], count: int, told: str) -> None:
    text = printed(frames(lidar=lidar, fused=fused, truth=[CAR_AT], cameras=[], count=count))
    assert text.splitlines()[2] == told
    assert "Fusion" not in printed(frames(lidar=lidar, fused=fused, truth=[CAR_AT], count=count))  # no 2D boxes
    assert ("There is no interval: a recording of 2 s" in text) == (count == 20)
    assert ("The interval is too narrow: a recording of 6 s" in text) == (count == 60)


@pytest.mark.parametrize(
    ("vans", "count", "told"),
    [
        (1, 20, f"Fusion adds 0.00 car AP over {OVER}{SHORT}"),
        (10, 20, f"Fusion removes 0.50 AP from {OVER}{SHORT}"),
        (1, 5, ""),
    ],
)
def test_a_rare_class_makes_no_headline(vans: int, count: int, told: str) -> None:
    there = [[CAR_AT, VAN_AT] if k < vans else [CAR_AT] for k in range(count)]
    seen = [frames(lidar=all_, truth=all_, fused=[CAR_AT], cameras=[], count=count)[k] for k, all_ in enumerate(there)]
    assert [line for line in printed(seen).splitlines() if line.startswith("Fusion")] == [told] * bool(told)


@pytest.mark.parametrize(
    ("fused", "told"),
    [
        ([CAR_AT, VAN_AT], "fused finds 50 % of the ground-truth objects; 50 % of its boxes are correct."),
        ([], "fused finds 0 % of the ground-truth objects; it reports no boxes."),
    ],
)
def test_how_much_is_found_comes_first(fused: list[Place], told: str) -> None:
    text = printed(frames(lidar=[CAR_AT], fused=fused, truth=[CAR_AT, (60.0, 0.0)]))
    assert text.splitlines()[1] == told


def test_average_precision_is_shown_at_the_overlap_of_kitti() -> None:
    figures = {f"{view}{iou}": iou / 100 for view in (AP_BEV, AP_3D) for iou in (25, 50, 70)}
    assert [shown_ap(name, figures)[AP_3D] for name in ("car", "bicycle")] == [0.7, 0.5]


def test_without_truth() -> None:
    text = printed(frames(lidar=[CAR_AT], fused=[CAR_AT], truth=None, ids=True))
    assert text.startswith("out.mcap: 20 frames, no ground truth: figures that need it are left out\n")
    assert "detection" not in text
    assert "Fusion" not in text
    assert "without ground truth: chains\n" in text
    assert "\nfused             1.0       1" in text
    untracked = [line.split() for line in printed(frames(lidar=[CAR_AT], fused=[], truth=None)).splitlines()]
    assert ["lidar", "1.0", *"------"] in untracked
    assert ["fused", "0.0", *"0--000"] in untracked


def test_requirements_and_warnings_come_last() -> None:
    found = frames(lidar=[CAR_AT], fused=[CAR_AT], truth=[CAR_AT])
    required = ["fused.car.recall > 0.5", "frames > 100", "fused.bus.recall > 0"]
    lines = printed(found, requirements=required, warnings=["something"]).splitlines()
    at = lines.index("required")
    assert lines[at + 2 :] == [
        "fused.car.recall     > 0.5      1  met",
        "frames               > 100     20  not met",
        "fused.bus.recall       > 0      -  not met",
        "note: a note",
        "warning: fused: something; try this",
    ]


MISTAKE: dict[str, Any] = {"class": "truck", "label": None, "cause": "nothing", "frames": 12, "worst_s": 1.25}
MISTAKE |= {"x_m": -12.34, "y_m": 5.0, "score": 0.875, "lidar_points": None}


@pytest.mark.parametrize(
    ("kind", "changes", "note"),
    [
        ("false", {}, "score 0.88, no object there"),
        ("false", {"label": "van", "cause": "class"}, "score 0.88, is a van"),
        ("false", {"label": "van", "cause": "second"}, "score 0.88, second box of a van"),
        ("missed", {"label": "truck", "lidar_points": 7}, "7 points"),
        ("missed", {"label": "truck"}, "points unknown"),
    ],
)
def test_notes(kind: str, changes: dict[str, Any], note: str) -> None:
    assert mistake_note(kind, MISTAKE | changes) == note
