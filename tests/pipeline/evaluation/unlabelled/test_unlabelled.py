from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import pytest
from detections import boxes2d, forward_camera
from evaluation_frames import frame_of, source_boxes
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import FrameError
from pipeline.core.rig import CameraSensor, Zone
from pipeline.core.settings.config import Config
from pipeline.core.settings.evaluate import EvaluateConfig
from pipeline.evaluation.records import EvaluationFrame, ImageBoxes, SourceBoxes
from pipeline.evaluation.unlabelled.evaluation import UnlabelledEvaluation

CAR, TRUCK = (4.0, 1.7, 1.5), (8.0, 2.5, 3.2)
CAR_ID, TRUCK_ID = 0, 3


def car(x: float, y: float = 0.0, yaw: float = 0.0) -> list[float]:
    return [x, y, 0.8, *CAR, yaw]


def figures(
    frames: list[EvaluationFrame],
    *,
    config: Config | None = None,
    zones: tuple[Zone, ...] = (),
    cameras: tuple[CameraSensor, ...] = (),
) -> dict[str, Any]:
    evaluation = UnlabelledEvaluation(config or Config(), zones, cameras)
    for frame in frames:
        evaluation.add(frame)
    tree: Any = evaluation.figures()
    result: dict[str, Any] = tree
    return result


def chains(frames: list[EvaluationFrame], name: str = "all") -> dict[str, Any]:
    result: dict[str, Any] = figures(frames)["unlabelled"]["fused"]["chains"][name]
    return result


def frames_of(*found: SourceBoxes) -> list[EvaluationFrame]:
    return [frame_of(k, None, {"fused": boxes}) for k, boxes in enumerate(found)]


def driving(count: int, speed_m: float = 1.0) -> list[SourceBoxes]:
    return [source_boxes([car(speed_m * k)]) for k in range(count)]


def test_nothing_at_all() -> None:
    assert figures([])["unlabelled"] == {}
    assert figures([])["sync"]["frames"] == 0
    nothing = chains(frames_of(source_boxes([]), source_boxes([])))
    assert {name for name, value in nothing.items() if value is not None} == {
        "chains",
        "flickers",
        "class_changes",
        "heading_flips",
    }
    assert nothing["chains"] == 0


def test_a_car_that_drives_is_one_chain() -> None:
    found = chains(frames_of(*driving(21)))
    assert (found["chains"], found["frames_mean"], found["seconds_mean"]) == (1, 21, pytest.approx(2))
    assert (found["single_frame_share"], found["missing_share"], found["flickers"]) == (0, 0, 0)
    assert (found["class_changes"], found["heading_flips"], found["length_spread"]) == (0, 0, 0)
    for name in ("lateral_m", "longitudinal_m", "yaw_deg"):
        assert found[f"{name}_mean"] == pytest.approx(0, abs=1e-9)
    assert (found["speed_outlier_share"], found["acceleration_outlier_share"]) == (0, 0)
    assert found["stopped_yaw_rate_deg_s_mean"] is None


def test_two_cars_side_by_side_are_two_chains() -> None:
    both = [source_boxes([car(k, 3.5), car(k)][:: (-1) ** k]) for k in range(10)]
    assert chains(frames_of(*both))["chains"] == 2


def test_cars_that_meet_go_on_as_they_were() -> None:
    both = [source_boxes([car(k, 2.0), car(20 - k, 0.0, pi)]) for k in range(21)]
    found = chains(frames_of(*both))
    assert (found["chains"], found["heading_flips"]) == (2, 0)


def test_who_vanishes_for_a_while_flickers() -> None:
    boxes = driving(20)
    for k in (6, 7, 12):
        boxes[k] = source_boxes([])
    found = chains(frames_of(*boxes))
    assert (found["chains"], found["flickers"], found["missing_share"]) == (1, 2, pytest.approx(3 / 20))


def test_who_is_away_for_long_is_a_new_chain() -> None:
    boxes = driving(20)
    for k in range(6, 12):
        boxes[k] = source_boxes([])
    found = chains(frames_of(*boxes))
    assert (found["chains"], found["flickers"], found["missing_share"]) == (2, 0, 0)
    seconds = [frame_of(k, None, {"fused": source_boxes([car(0)])}, stamp_ns=k * 1_100_000_000) for k in range(3)]
    assert chains(seconds)["chains"] == 3


def test_chains_end_where_time_goes_back() -> None:
    stamps_ns = [0, 100_000_000, 0, 100_000_000]
    for tracks in (None, [7]):
        frames = [
            frame_of(k, None, {"fused": source_boxes([car(0)], tracks)}, stamp_ns=stamp_ns)
            for k, stamp_ns in enumerate(stamps_ns)
        ]
        assert (chains(frames)["chains"], chains(frames)["frames_mean"]) == (2, 2)


def test_no_road_user_jumps() -> None:
    assert chains(frames_of(source_boxes([car(0)]), source_boxes([car(3.9)])))["chains"] == 1
    assert chains(frames_of(source_boxes([car(0)]), source_boxes([car(4.1)])))["chains"] == 2


def test_tracks_go_before_places() -> None:
    boxes = [source_boxes([car(0), car(50), car(9)], [5, 6, -1]), source_boxes([car(50), car(0)], [5, 6])]
    tree = figures(frames_of(*boxes))["unlabelled"]["fused"]
    assert (tree["chains_by"], tree["boxes_without_track"], tree["chains"]["all"]["chains"]) == ("track", 1, 2)
    assert tree["chains"]["all"]["speed_outlier_share"] == 1
    assert figures(frames_of(*driving(2)))["unlabelled"]["fused"]["chains_by"] == "place"


def test_changes_within_a_chain() -> None:
    boxes = driving(12)
    boxes[4] = source_boxes([car(4, 0, pi)])
    boxes[8] = source_boxes([[8, 0, 0.8, *TRUCK, 0]], class_ids=[TRUCK_ID])
    tree = figures(frames_of(*boxes))["unlabelled"]["fused"]["chains"]
    assert (tree["all"]["chains"], tree["all"]["heading_flips"], tree["all"]["class_changes"]) == (1, 2, 2)
    lengths = np.array([4.0] * 11 + [8.0])
    assert tree["all"]["length_spread"] == pytest.approx(lengths.std() / lengths.mean())
    # A chain belongs to the class that most of its boxes have.
    assert (tree["car"]["chains"], tree["truck"]["chains"]) == (1, 0)
    assert tree["truck"]["max_speed_mps"] == 120
    assert tree["all"]["max_speed_mps"] is None


def test_one_box_aside_leaves_the_path() -> None:
    boxes = driving(21)
    boxes[10] = source_boxes([car(10.2, 1.1)])
    found = chains(frames_of(*boxes))
    # Eleven boxes have a whole window; in each of them the odd box is one of eleven.
    aside = [0.1] * 10 + [1.0]
    along = [0.2 / 11] * 10 + [0.2 * 10 / 11]
    assert found["lateral_m_mean"] == pytest.approx(np.mean(aside), abs=1e-3)
    assert found["lateral_m_p90"] == pytest.approx(np.percentile(aside, 90), abs=2e-3)
    assert found["longitudinal_m_mean"] == pytest.approx(np.mean(along), abs=1e-3)


def test_boxes_that_look_aside() -> None:
    boxes = [source_boxes([car(k, 0, 0.1 if k % 2 else pi - 0.1)]) for k in range(11)]
    assert chains(frames_of(*boxes))["yaw_deg_mean"] == pytest.approx(np.rad2deg(0.1))


def test_who_stands_still_and_turns() -> None:
    boxes = [source_boxes([car(5, 5, 0.01 * (k % 2) + pi * (k % 3 == 0))]) for k in range(15)]
    found = chains(frames_of(*boxes))
    assert found["stopped_yaw_rate_deg_s_mean"] == pytest.approx(np.rad2deg(0.1))
    assert found["yaw_deg_mean"] is None


def test_accelerations_beyond_any_car() -> None:
    def at(k: int) -> float:
        return 0.0 if k < 6 else 3.0 * (k - 6)

    found = chains(frames_of(*(source_boxes([car(at(k))], [1]) for k in range(13))))
    assert found["speed_outlier_share"] == 0
    assert found["acceleration_outlier_share"] == 1


PATH = st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2)), min_size=12, max_size=20)


@settings(max_examples=25)
@given(PATH, st.floats(-1000, 1000), st.floats(-pi, pi))
def test_where_the_site_lies_does_not_matter(path: list[tuple[float, float, float]], shift: float, turn: float) -> None:
    cos, sin = np.cos(turn), np.sin(turn)

    def moved(x: float, y: float, yaw: float) -> list[float]:
        return car(cos * x - sin * y + shift, sin * x + cos * y - shift, yaw + turn)

    places = [(0.8 * k + dx, dy, dyaw) for k, (dx, dy, dyaw) in enumerate(path)]
    here = chains(frames_of(*(source_boxes([car(*place)]) for place in places)))
    there = chains(frames_of(*(source_boxes([moved(*place)]) for place in places)))
    assert there == pytest.approx(here, abs=1e-6)


@settings(max_examples=25)
@given(PATH)
def test_the_way_back_is_as_smooth(path: list[tuple[float, float, float]]) -> None:
    boxes = [source_boxes([car(0.8 * k + dx, dy, dyaw)], [1]) for k, (dx, dy, dyaw) in enumerate(path)]
    forth, back = chains(frames_of(*boxes)), chains(frames_of(*boxes[::-1]))
    for figure in (forth, back):
        del figure["stopped_yaw_rate_deg_s_mean"], figure["stopped_yaw_rate_deg_s_p90"]
    assert back == pytest.approx(forth, abs=1e-9)


def test_objects_are_counted_by_class_range_and_zone() -> None:
    zones = tuple(
        Zone(name, np.array([[-99.0, low], [99, low], [99, low + 99], [-99, low + 99]]))
        for name, low in (("north", 0.0), ("south", -99.0))
    )
    boxes = [source_boxes([car(5, 1), car(5, -1), car(15, 200)]), source_boxes([car(30, 1)], class_ids=[TRUCK_ID])]
    objects = figures(frames_of(*boxes), zones=zones)["unlabelled"]["fused"]["objects"]
    assert (objects["frames"], objects["per_frame_mean"], objects["per_frame_max"]) == (2, 2, 3)
    assert objects["classes"]["truck"] == {"per_frame_mean": 0.5, "per_frame_max": 1}
    assert {name: entry["per_frame_mean"] for name, entry in objects["ranges"].items()} == {
        "0_10": 1,
        "10_20": 0,
        "20_40": 0.5,
        "40_80": 0,
        "over_80": 0.5,
    }
    assert objects["zones"]["north"] == {"per_frame_mean": 1, "per_frame_max": 1}
    assert objects["zones"]["south"] == {"per_frame_mean": 0.5, "per_frame_max": 1}
    assert [part["zones"] for part in objects["over_time"]] == [{"north": 1, "south": 1}, {"north": 1, "south": 0}]


def test_parts_of_a_recording_are_not_too_many() -> None:
    for count, expected in ((1, 1), (50, 50), (300, 60)):
        parts = figures(frames_of(*driving(count)))["unlabelled"]["fused"]["objects"]["over_time"]
        assert len(parts) == expected
        assert sum(part["frames"] for part in parts) == count
        assert {part["per_frame_mean"] for part in parts} == {1}


def test_only_the_region_is_looked_at() -> None:
    config = Config(evaluate=EvaluateConfig(max_range_m=10))
    tree = figures(frames_of(source_boxes([car(5), car(15)])), config=config)["unlabelled"]["fused"]
    assert (tree["objects"]["per_frame_mean"], tree["chains"]["all"]["chains"]) == (1, 1)


CAMERA = forward_camera()
AHEAD = [10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]
BEHIND = [-10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]
# Its nearest face is 8 m away: 500 px / 8 m * 2 m wide, 1.5 m high, around the middle of the image.
LEFT, TOP, RIGHT, BOTTOM = 320 - 62.5, 240 - 46.875, 320 + 62.5, 240 + 46.875


def seen(*rows: list[float]) -> dict[str, ImageBoxes]:
    return {"cam": ImageBoxes(boxes2d(list(rows)))}


def image_figures(frames: list[EvaluationFrame], **settings: float) -> dict[str, Any]:
    config = Config.model_validate({"associate": settings})
    tree = figures(frames, config=config, cameras=(CAMERA,))["unlabelled"]
    result: dict[str, Any] = tree["lidar"]["images"]["cam"]
    return result


def test_a_box_that_fits_has_no_residual() -> None:
    exact = [LEFT, TOP, RIGHT, BOTTOM, 0.9, CAR_ID]
    found = image_figures([frame_of(0, None, {"lidar": source_boxes([AHEAD, BEHIND])}, seen(exact))])
    assert (found["matches"], found["boxes_3d_in_view"], found["boxes_2d"]) == (1, 1, 1)
    assert (found["unmatched_3d_share"], found["unmatched_2d_share"]) == (0, 0)
    assert found["offset_u_mean_px"] == pytest.approx(0, abs=1e-3)
    assert found["size_ratio_mean"] == pytest.approx(1, abs=1e-5)
    assert found["iou_p50"] == pytest.approx(1, abs=1e-5)
    assert found["drift_u_px_per_min"] is None


def test_residuals_drift() -> None:
    frames = [
        frame_of(
            k,
            None,
            {"lidar": source_boxes([AHEAD])},
            seen([LEFT + 2 * k, TOP - 3, RIGHT + 2 * k, BOTTOM - 3, 0.9, CAR_ID]),
        )
        for k in range(5)
    ]
    found = image_figures(frames)
    assert found["drift_u_px_per_min"] is None
    frames = [replace(frame, stamp_ns=3_000_000_000 * k) for k, frame in enumerate(frames)]
    found = image_figures(frames)
    assert found["offset_u_mean_px"] == pytest.approx(4, abs=1e-3)
    assert found["offset_v_abs_p90_px"] == pytest.approx(3, abs=1e-3)
    assert found["offset_v_mean_px"] == pytest.approx(-3, abs=1e-3)
    assert found["drift_u_px_per_min"] == pytest.approx(2 * 20, rel=1e-4)
    assert found["drift_v_px_per_min"] == pytest.approx(0, abs=1e-3)


def test_boxes_without_a_partner_are_counted() -> None:
    elsewhere = [0.0, 0.0, 50.0, 50.0, 0.9, CAR_ID]
    frames = [frame_of(0, None, {"lidar": source_boxes([AHEAD])}, seen(elsewhere))]
    frames += [frame_of(1, None, {"lidar": source_boxes([AHEAD])})]  # no image: nothing can be compared
    found = image_figures(frames)
    assert (found["matches"], found["unmatched_3d_share"], found["unmatched_2d_share"]) == (0, 1, 1)
    assert found["iou_mean"] is None
    nothing = image_figures([frame_of(0, None, {"lidar": source_boxes([BEHIND])}, seen())])
    assert (nothing["unmatched_3d_share"], nothing["unmatched_2d_share"]) == (None, None)


def test_boxes_are_matched_as_the_fusion_does_it() -> None:
    truck = [LEFT, TOP, RIGHT, BOTTOM, 0.9, TRUCK_ID]
    frames = [frame_of(0, None, {"lidar": source_boxes([AHEAD])}, seen(truck))]
    assert image_figures(frames)["matches"] == 1
    car_beside = [LEFT - 10, TOP, RIGHT - 10, BOTTOM, 0.9, CAR_ID]
    frames = [frame_of(0, None, {"lidar": source_boxes([AHEAD])}, seen(truck, car_beside))]
    assert image_figures(frames)["offset_u_mean_px"] == pytest.approx(-10, abs=1e-3)
    assert image_figures(frames, any_class=1.0)["offset_u_mean_px"] == pytest.approx(0, abs=1e-3)
    shifted = [LEFT + 45, TOP, RIGHT + 45, BOTTOM, 0.9, CAR_ID]
    frames = [frame_of(0, None, {"lidar": source_boxes([AHEAD])}, seen(shifted))]
    assert image_figures(frames, min_giou=0.4)["matches"] == 1
    assert image_figures(frames, min_giou=0.5)["matches"] == 0
    assert image_figures(frames, gate=2)["matches"] == 0


def test_residuals_of_long_recordings_are_those_of_all_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [
        frame_of(k, None, {"lidar": source_boxes([AHEAD])}, seen([LEFT + k, TOP, RIGHT, BOTTOM, 0.9, CAR_ID]))
        for k in range(10)
    ]
    whole = image_figures(frames)
    monkeypatch.setattr("pipeline.evaluation.unlabelled.residuals.BLOCK_FRAMES", 3)
    assert image_figures(frames) == whole
    assert whole["matches"] == 10


def test_boxes_of_another_frame_are_refused() -> None:
    def named(boxes: SourceBoxes) -> SourceBoxes:
        return replace(boxes, boxes=replace(boxes.boxes, frame_id="base_link"))

    sound = frame_of(0, None, {"lidar": source_boxes([AHEAD])}, seen())
    with pytest.raises(FrameError, match="expected boxes in frame 'site', found 'base_link'"):
        image_figures([sound, frame_of(1, None, {"lidar": named(source_boxes([AHEAD]))}, seen())])
    nothing = frame_of(1, None, {"lidar": named(source_boxes([]))}, seen())
    assert image_figures([sound, nothing])["boxes_3d_in_view"] == 1


def test_skews_and_missing_cameras() -> None:
    skews_ns = [1_000_000, 2_000_000, None, 9_000_000]
    frames = [frame_of(k, None, {}, seen() if k else None, skew_ns=skew_ns) for k, skew_ns in enumerate(skews_ns)]
    sync = figures(frames, cameras=(CAMERA, forward_camera("other")))["sync"]
    assert (sync["frames"], sync["frames_without_skew"]) == (4, 1)
    assert (sync["skew_mean_ms"], sync["skew_p50_ms"], sync["skew_max_ms"]) == (4, 2, 9)
    assert sync["skew_p95_ms"] == pytest.approx(np.percentile([1, 2, 9], 95))
    assert sync["cameras"] == {"cam": {"missing_share": 0.25}, "other": {"missing_share": 1.0}}
    assert figures([frame_of(0, None, {})])["sync"]["skew_mean_ms"] is None


def test_figures_may_be_asked_for_at_any_time() -> None:
    frames = [
        frame_of(k, None, {"lidar": source_boxes([AHEAD])}, seen([LEFT + k, TOP, RIGHT, BOTTOM, 0.9, CAR_ID]))
        for k in range(6)
    ]
    evaluation = UnlabelledEvaluation(Config(), (), (CAMERA,))
    for frame in frames:
        evaluation.add(frame)
        evaluation.figures()
    assert evaluation.figures() == evaluation.figures() == figures(frames, cameras=(CAMERA,))
