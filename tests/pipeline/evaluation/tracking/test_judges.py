"""Figures of tracks are those that TrackEval and motmetrics give, recorded once for the cases of `track_cases`.

TrackEval's HOTA was asked with the similarity max(0, 1 - distance / 2 m), its Identity with max(0, 1 - distance / 4 m)
above 0.5, both over frames whose tracks are numbered from 0; `all` are its classes, each case one, averaged over the
detections. motmetrics' accumulator was given the distances below 2 m. The versions stand in the files.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from evaluation_frames import frame_of, source_boxes, truth_boxes
from track_cases import CASES, LENGTH_M, TIES, TIES_OF_TRACKS, WIDTH_M, TrackCase

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.tracking.tracking_evaluation import TrackingEvaluation

ERRORS = ("id_switches", "false_positives", "misses", "fragmentations")
SIZE = (LENGTH_M, WIDTH_M, 1.5)
TOLERANCE = 1e-9
SOME = {name for name in CASES if name[-2:] not in ("_2", "_3", "_4", "_5")}
"""Of each kind of case no more than two, where another judge is asked about all of them."""


def said(judge: str) -> dict[str, Any]:
    path = Path(__file__).parent / "recorded" / f"{judge}.json"
    cases: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))["cases"]
    return cases


@cache
def figures_of(name: str) -> dict[str, Any]:
    case = CASES[name]()
    evaluation = TrackingEvaluation(Config())
    add_case(evaluation, case)
    # Without a box there is no track, and without a track there are no figures: a track of another class brings them.
    found = source_boxes([[900, 900, 0, *SIZE, 0]], [0], class_ids=[1])
    evaluation.add_frame(frame_of(len(case.truth), truth_boxes([]), {"fused": found}))
    figures: Any = evaluation.figures()
    car: dict[str, Any] = figures["tracking"]["fused"]["car"]
    return car


def add_case(evaluation: TrackingEvaluation, case: TrackCase, class_id: int = 0) -> None:
    for index, (truth, found) in enumerate(zip(case.truth, case.found, strict=True)):
        # Neither the order of the objects nor the numbers of their tracks may matter.
        true = truth_boxes(
            [[row.x, row.y, 0, *SIZE, row.yaw] for row in truth][::-1],
            [10 * row.track + 3 for row in truth][::-1],
            class_ids=[class_id] * len(truth),
        )
        boxes = source_boxes(
            [[row.x, row.y, 0, *SIZE, row.yaw] for row in found][::-1],
            [10 * row.track + 3 for row in found][::-1],
            class_ids=[class_id] * len(found),
            scores=[row.score for row in found][::-1],
        )
        evaluation.add_frame(frame_of(index, true, {"fused": boxes}))


@pytest.mark.parametrize("name", sorted(CASES.keys() - TIES_OF_TRACKS))
def test_hota_is_that_of_trackeval(name: str) -> None:
    ours, theirs = figures_of(name), said("trackeval")[name]
    keys = ("HOTA", "DetA", "AssA", "DetRe", "DetPr", "AssRe", "AssPr", "LocA")
    names = ("hota", "det_a", "ass_a", "det_re", "det_pr", "ass_re", "ass_pr", "loc_a")
    for key, figure in zip(keys, names, strict=True):
        if ours[figure] is None:  # TrackEval has a number for what is not defined
            assert name == "nothing_found"
            assert theirs["hota"][key] == {"LocA": 1}.get(key, 0)
        else:
            assert ours[figure] == pytest.approx(theirs["hota"][key], abs=TOLERANCE)


@pytest.mark.parametrize("name", sorted(SOME))
def test_identity_is_that_of_motmetrics(name: str) -> None:
    ours, theirs = figures_of(name), said("motmetrics")[name]
    for key in ("idf1", "idp", "idr"):
        assert ours[key] == pytest.approx(theirs[key], abs=TOLERANCE)


@pytest.mark.parametrize("name", sorted(SOME - TIES))
def test_clear_is_that_of_motmetrics(name: str) -> None:
    ours, theirs = figures_of(name), said("motmetrics")[name]
    keys: tuple[str, ...] = ("num_switches", "num_false_positives", "num_misses", "num_fragmentations")
    keys += ("mota", "motp")
    for figure, key in zip((*ERRORS, "mota", "motp_m"), keys, strict=True):
        assert ours[figure] == pytest.approx(theirs[key], abs=TOLERANCE), figure


def test_hota_of_all_classes_is_that_of_trackeval() -> None:
    """Each case is a class of its own there; here, a scale of 1 needs classes of one length."""
    names = sorted(CASES.keys() - TIES_OF_TRACKS)
    priors = tuple(Config().classes[0].model_copy(update={"name": name}) for name in names)
    evaluation = TrackingEvaluation(Config(classes=priors))
    for class_id, name in enumerate(names):
        add_case(evaluation, CASES[name](), class_id)
    figures: Any = evaluation.figures()
    fused = figures["tracking"]["fused"]
    assert {fused[name]["match_distance_m"] for name in names} == {2.0}
    theirs = said("trackeval")["all"]
    assert fused["all"]["idf1"] == pytest.approx(theirs["identity"]["IDF1"], abs=1e-9)
    for key, figure in (("HOTA", "hota"), ("DetA", "det_a"), ("AssA", "ass_a"), ("LocA", "loc_a"), ("AssRe", "ass_re")):
        assert fused["all"][figure] == pytest.approx(theirs["hota"][key], abs=1e-9)
