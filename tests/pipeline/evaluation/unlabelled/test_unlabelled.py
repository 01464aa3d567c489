from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import pytest
from detections import boxes2d, forward_camera
from evaluation_frames import frame_of, source_boxes
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, ImageBoxes, SourceBoxes
from lidcam.pipeline.evaluation.unlabelled.unlabelled_evaluation import UnlabelledEvaluation

CAR, TRUCK = (4.0, 1.7, 1.5), (8.0, 2.5, 3.2)
CAR_ID, TRUCK_ID = 0, 3


def car(x: float, y: float = 0.0, yaw: float = 0.0) -> list[float]:
    return [x, y, 0.8, *CAR, yaw]


def figures(
    frames: list[EvaluationFrame], *, config: Config | None = None, cameras: tuple[CameraSensor, ...] = ()
) -> dict[str, Any]:
    evaluation = UnlabelledEvaluation(config or Config(), cameras)
    for frame in frames:
        evaluation.add(frame)
    tree: Any = evaluation.figures()
    result: dict[str, Any] = tree
    return result


def chains(frames: list[EvaluationFrame]) -> dict[str, Any]:
    result: dict[str, Any] = figures(frames)["unlabelled"]["fused"]["chains"]
    return result


def frames_of(*found: SourceBoxes) -> list[EvaluationFrame]:
    return [frame_of(k, None, {"fused": boxes}) for k, boxes in enumerate(found)]


def driving(count: int, *missing: int) -> list[SourceBoxes]:
    """A car that drives a metre a frame, and is not found in some."""
    return [source_boxes([] if k in missing else [car(k)]) for k in range(count)]


def test_nothing_at_all() -> None:
    assert figures([]) == {"unlabelled": {}, "sync": {"skew_mean_ms": None, "skew_max_ms": None}}
    none = {"chains": 0, "flickers": 0, "class_changes": 0, "heading_flips": 0}
    assert chains(frames_of(source_boxes([]), source_boxes([]))) == none | {"seconds_mean": None, "missing_share": None}


@pytest.mark.parametrize(
    ("missing", "count", "flickers", "missing_share"),
    [((), 1, 0, 0), ((6, 7, 12), 1, 2, 3 / 20), (tuple(range(6, 11)), 1, 1, 5 / 20), (tuple(range(6, 12)), 2, 0, 0)],
)
def test_who_vanishes_for_a_while_flickers(
    missing: tuple[int, ...], count: int, flickers: int, missing_share: float
) -> None:
    found = chains(frames_of(*driving(20, *missing)))
    assert (found["chains"], found["flickers"]) == (count, flickers)
    assert found["missing_share"] == pytest.approx(missing_share)
    if count == 1:
        assert found["seconds_mean"] == pytest.approx(1.9)


@pytest.mark.parametrize(("x", "count"), [(3.9, 1), (4.1, 2)])  # a car that nobody has seen before drives up to 4 m
def test_no_road_user_jumps(x: float, count: int) -> None:
    assert chains(frames_of(source_boxes([car(0)]), source_boxes([car(x)])))["chains"] == count


def test_cars_that_meet_go_on_as_they_were() -> None:
    both = [source_boxes([car(k, 2.0), car(20 - k, 0.0, pi)]) for k in range(21)]
    assert (chains(frames_of(*both))["chains"], chains(frames_of(*both))["heading_flips"]) == (2, 0)


@pytest.mark.parametrize("tracks", [None, [7]])
@pytest.mark.parametrize(
    ("stamps_s", "count"), [((0, 0.1, 0, 0.1), 2), ((0, 0.9, 1.8), 1)], ids=["time goes back", "slow"]
)
def test_chains_end_where_time_goes_back(tracks: list[int] | None, stamps_s: tuple[float, ...], count: int) -> None:
    frames = [
        frame_of(k, None, {"fused": source_boxes([car(0)], tracks)}, stamp_ns=round(second * 1e9))
        for k, second in enumerate(stamps_s)
    ]
    assert chains(frames)["chains"] == count


def test_tracks_go_before_places() -> None:
    boxes = [source_boxes([car(0), car(50), car(9)], [5, 6, -1]), source_boxes([car(50), car(0)], [5, 6])]
    assert chains(frames_of(*boxes))["chains"] == 2
    assert chains(frames_of(*(source_boxes([car(x)], [5]) for x in (0, 50))))["chains"] == 1


def test_changes_within_a_chain() -> None:
    boxes = driving(12)
    boxes[4] = source_boxes([car(4, 0, pi)])
    boxes[8] = source_boxes([[8, 0, 0.8, *TRUCK, 0]], class_ids=[TRUCK_ID])
    found = chains(frames_of(*boxes))
    assert (found["chains"], found["heading_flips"], found["class_changes"]) == (1, 2, 2)


PATH = st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2)), min_size=12, max_size=20)


@settings(max_examples=25)
@given(PATH, st.floats(-1000, 1000), st.floats(-pi, pi))
def test_where_the_site_lies_does_not_matter(path: list[tuple[float, float, float]], shift: float, turn: float) -> None:
    cos, sin = np.cos(turn), np.sin(turn)

    def moved(x: float, y: float, yaw: float) -> list[float]:
        return car(cos * x - sin * y + shift, sin * x + cos * y - shift, yaw + turn)

    places = [(0.8 * k + dx, dy, dyaw) for k, (dx, dy, dyaw) in enumerate(path)]
    here = chains(frames_of(*(source_boxes([car(*place)]) for place in places)))
    assert chains(frames_of(*(source_boxes([moved(*place)]) for place in places))) == pytest.approx(here, abs=1e-6)


def test_only_the_region_is_looked_at() -> None:
    config = Config(evaluate=EvaluateConfig(max_range_m=10))
    tree = figures(frames_of(source_boxes([car(5), car(15)]), source_boxes([])), config=config)["unlabelled"]["fused"]
    assert (tree["objects"]["per_frame_mean"], tree["chains"]["chains"]) == (0.5, 1)


CAMERA = forward_camera()
AHEAD = [10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]
BEHIND = [-10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]
# Its nearest face is 8 m away: 500 px / 8 m * 2 m wide, 1.5 m high, around the middle of the image.
LEFT, TOP, RIGHT, BOTTOM = 320 - 62.5, 240 - 46.875, 320 + 62.5, 240 + 46.875


def seen(*rows: list[float]) -> dict[str, ImageBoxes]:
    return {"cam": ImageBoxes(boxes2d(list(rows)))}


def beside(right_px: float = 0.0, down_px: float = 0.0, class_id: int = CAR_ID) -> list[float]:
    """A 2D box of the object ahead, shifted."""
    return [LEFT + right_px, TOP + down_px, RIGHT + right_px, BOTTOM + down_px, 0.9, class_id]


def pictured(*rows: list[float], index: int = 0, boxes: tuple[list[float], ...] = (AHEAD,)) -> EvaluationFrame:
    return frame_of(index, None, {"fused": source_boxes([*boxes])}, seen(*rows))


def image_figures(frames: list[EvaluationFrame]) -> dict[str, Any]:
    result: dict[str, Any] = figures(frames, cameras=(CAMERA,))["unlabelled"]["fused"]["images"]["cam"]
    return result


def test_a_box_that_fits_has_no_residual() -> None:
    found = image_figures([pictured(beside(), boxes=(AHEAD, BEHIND))])
    assert (found["matches"], found["boxes_3d_in_view"], found["boxes_2d"]) == (1, 1, 1)
    assert (found["unmatched_3d_share"], found["unmatched_2d_share"]) == (0, 0)
    assert found["offset_u_p50_px"] == pytest.approx(0, abs=1e-3)
    assert found["iou_p50"] == pytest.approx(1, abs=1e-5)


def test_residuals_are_those_of_all_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [pictured(beside(2 * k, -3), index=k) for k in range(5)]
    whole = image_figures(frames)
    assert (whole["matches"], whole["offset_u_p50_px"]) == (5, pytest.approx(4, abs=1e-3))
    assert whole["offset_u_abs_p90_px"] == pytest.approx(np.percentile([0, 2, 4, 6, 8], 90), abs=1e-3)
    assert whole["offset_v_p50_px"] == pytest.approx(-3, abs=1e-3)
    monkeypatch.setattr("lidcam.pipeline.evaluation.unlabelled.residuals.BLOCK_FRAMES", 3)
    assert image_figures(frames) == whole
    evaluation = UnlabelledEvaluation(Config(), (CAMERA,))
    for frame in frames:
        evaluation.add(frame)
        evaluation.figures()
    assert evaluation.figures() == figures(frames, cameras=(CAMERA,)), "figures may be asked for at any time"


def test_boxes_without_a_partner_are_counted() -> None:
    no_image = frame_of(1, None, {"fused": source_boxes([AHEAD])})  # nothing can be compared
    found = image_figures([pictured([0.0, 0.0, 50.0, 50.0, 0.9, CAR_ID]), no_image])
    assert (found["matches"], found["unmatched_3d_share"], found["unmatched_2d_share"]) == (0, 1, 1)
    assert found["iou_p50"] is None
    nothing = image_figures([pictured(boxes=(BEHIND,))])
    assert (nothing["unmatched_3d_share"], nothing["unmatched_2d_share"]) == (None, None)


def test_boxes_are_matched_as_the_fusion_does_it() -> None:
    truck = beside(class_id=TRUCK_ID)
    assert image_figures([pictured(truck)])["matches"] == 1
    both = [pictured(truck, beside(-10))]
    assert image_figures(both)["offset_u_p50_px"] == pytest.approx(-10, abs=1e-3)


def test_boxes_of_another_frame_are_refused() -> None:
    def named(boxes: SourceBoxes) -> SourceBoxes:
        return replace(boxes, boxes=replace(boxes.boxes, frame_id="base_link"))

    with pytest.raises(FrameError, match="expected boxes in frame 'site', found 'base_link'"):
        image_figures([pictured(), frame_of(1, None, {"fused": named(source_boxes([AHEAD]))}, seen())])
    nothing = frame_of(1, None, {"fused": named(source_boxes([]))}, seen())
    assert image_figures([pictured(), nothing])["boxes_3d_in_view"] == 1


def test_skews() -> None:
    frames = [frame_of(k, None, {}, skew_ns=ns) for k, ns in enumerate([1_000_000, 2_000_000, None, 9_000_000])]
    assert figures(frames)["sync"] == {"skew_mean_ms": 4, "skew_max_ms": 9}
