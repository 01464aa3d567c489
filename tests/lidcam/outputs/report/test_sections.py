"""What a page says of a result, with what to do; and that nothing recorded gets into its HTML."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evaluation_frames import frame_of, source_boxes
from frames import CONFIG, RIG

from lidcam.outputs.report import sections
from lidcam.pipeline.evaluation.evaluation_frame import Motion, SourceBoxes
from lidcam.run.warning import RunWarning
from lidcam.writers.report import html
from lidcam.writers.report.collector import ReportCollector
from lidcam.writers.report.page import page

HOSTILE = "<script>alert(1)</script>"
WARNING = RunWarning("cam0", "silent throughout", "check its driver")
NAMES = CONFIG.class_names


def seen_of(*frames: SourceBoxes) -> ReportCollector:
    seen = ReportCollector(CONFIG, RIG)
    for index, source in enumerate(frames):
        seen.add(frame_of(index, None, {"fused": source}))
    return seen


def tracked(*places: tuple[float, float], numbers: list[int]) -> SourceBoxes:
    boxes = source_boxes([(x, y, 0.75, 4.0, 1.7, 1.5, 0.0) for x, y in places]).boxes
    motion = Motion(np.full((len(places), 2), 3.0), np.zeros(len(places)), np.zeros(len(places), np.bool_))
    return SourceBoxes(boxes, np.array(numbers, np.int64), motion)


ONE = tracked((1.0, 2.0), numbers=[4])


@pytest.mark.parametrize(
    ("summary", "warnings", "said"),
    [
        ({}, [], "kept no summary"),
        ({"frames": 1}, [], "Nothing doubtful"),
        ({"frames": 1}, [WARNING], "1 thing to look at"),
        ({"frames": 1}, [WARNING], "check its driver"),
        ({"frames": 1, "incomplete": ["cam1 is left out"]}, [WARNING], "2 things to look at"),
    ],
)
def test_doubts_are_said_with_what_to_do(summary: dict[str, Any], warnings: list[RunWarning], said: str) -> None:
    assert said in sections.doubts(seen_of(ONE), summary, warnings, "0.1.0")


def test_ways_are_drawn_from_the_sensors_where_they_move_nobody_knows_where_to() -> None:
    nowhere = replace(frame_of(0, None, {"fused": ONE}), T_fixed_site=None)
    unknown, adrift = ReportCollector(CONFIG, RIG), ReportCollector(CONFIG, RIG, is_adrift=True)
    unknown.add(nowhere)
    adrift.add(nowhere)
    assert (unknown.poses_known, unknown.is_tracked) == (0, False)
    assert (adrift.poses_known, adrift.is_tracked, adrift.travelled_m) == (1, True, 0)
    assert "1 road user" in sections.verdict("out.mcap", adrift, NAMES)


def test_a_result_without_objects_says_what_to_try() -> None:
    nothing = seen_of(tracked(numbers=[]), tracked(numbers=[]))
    assert "Nothing was found in 0.1 s." in sections.verdict("out.mcap", nothing, NAMES)
    assert "lidcam inspect RECORDING --check" in sections.doubts(nothing, {"frames": 2}, [], "0.1.0")


def test_road_users_count_once() -> None:
    seen = seen_of(ONE, ONE, tracked((1.0, 2.0), (50.0, 50.0), numbers=[4, 9]))
    told = sections.verdict("out.mcap", seen, NAMES)
    assert "2 road users in 0.2 s: 2 \u00d7 car." in told
    assert "4.2 m/s" in told


def test_nobody_is_counted_without_tracks() -> None:
    seen = seen_of(source_boxes([(1.0, 2.0, 0.75, 4.0, 1.7, 1.5, 0.0)]))
    assert "They were not tracked" in sections.verdict("out.mcap", seen, NAMES)
    assert not seen.is_tracked


def test_what_was_dropped_is_listed_faults_first() -> None:
    drop = {"unit": "messages", "example": "", "is_defect": False}
    summary = {
        "drops": [
            {"topic": "/a", "reason": "no partner", "count": 2, **drop},
            {"topic": "/b", "reason": "cannot be decoded", "count": 1, **drop, "is_defect": True, "example": HOSTILE},
        ],
        "missing": [
            {
                "sensor": "cam0",
                "frames": 9,
                "of_frames": 20,
                "silences": [{"start_s": None, "end_s": 1.5, "frames": 9}],
            },
            {"sensor": "slow", "frames": 10, "of_frames": 20, "silences": []},
        ],
        "unused_topics": {"/radar": 3},
        "losses": [{"file": "a.bag", "messages": None, "reason": "cut"}],
        "notes": ["a note"],
    }
    told = sections.dropped(summary)
    assert told.index("/b") < told.index("/a")
    assert "the message is at fault: cannot be decoded" in told
    assert "0.0 s to 1.5 s" in told
    assert "slow" not in told  # its rate is among the sensors
    assert all(words in told for words in ("/radar (3)", "unknown", "a note"))
    assert HOSTILE not in told
    assert not sections.dropped({})


def test_recorded_names_are_no_html() -> None:
    content = html.table([HOSTILE], [[HOSTILE]]) + html.paragraph(HOSTILE) + html.section("a", HOSTILE, html.text("b"))
    whole = page(HOSTILE, html.Raw(content), {"map": {"data": [{"name": HOSTILE}], "layout": {}}})
    assert HOSTILE not in whole
