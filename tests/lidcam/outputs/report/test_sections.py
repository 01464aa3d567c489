"""The content of a page about a result, with what to do; and that nothing recorded gets into its HTML."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evaluation_frames import frame_of, source_boxes
from frames import CONFIG, RIG

from lidcam.outputs.report import sections
from lidcam.outputs.report.images import _scene_from_above
from lidcam.pipeline.evaluation.evaluation_frame import FrameSync, Motion, SourceBoxes
from lidcam.run.warning import RunWarning
from lidcam.writers.palette import class_color
from lidcam.writers.report.collector import Moment, ReportCollector
from lidcam.writers.report.grid import SparseGrid
from lidcam.writers.report.page import PageTable, page, prose
from lidcam.writers.report.site_map import map_extent

HOSTILE = "<script>alert(1)</script>"
WARNING = RunWarning("cam0", "silent throughout", "check its driver")
LEFT_OUT = "not used", "cam1 is left out", ""
NAMES = CONFIG.class_names


def seen_of(*frames: SourceBoxes) -> ReportCollector:
    seen = ReportCollector(CONFIG, RIG)
    for index, source in enumerate(frames):
        seen.add_frame(frame_of(index, None, {"fused": source}))
    return seen


def tracked(*places: tuple[float, float], numbers: list[int], speed: float = 3.0) -> SourceBoxes:
    boxes = source_boxes([(x, y, 0.75, 4.0, 1.7, 1.5, 0.0) for x, y in places]).boxes
    count = len(places)
    flags = np.zeros(count, np.bool_), np.full(count, speed > 0)
    motion = Motion(np.full((count, 2), speed), np.zeros(count), *flags)
    return SourceBoxes(boxes, np.array(numbers, np.int64), motion)


ONE = tracked((1.0, 2.0), numbers=[4])


@pytest.mark.parametrize(
    ("summary", "warnings", "said"),
    [
        ({}, [], []),
        ({"incomplete": [LEFT_OUT[1]]}, [WARNING], [("cam0", "silent throughout", "check its driver"), LEFT_OUT]),
    ],
)
def test_doubts_are_said_with_what_to_do(
    summary: dict[str, Any], warnings: list[RunWarning], said: list[tuple[str, str, str]]
) -> None:
    assert sections.doubts(seen_of(ONE), summary, warnings) == said


def test_steps_back_in_time_are_no_time() -> None:
    seen = ReportCollector(CONFIG, RIG)
    for index, stamp_ns in enumerate((0, 1, 2, -500, -499)):
        seen.add_frame(replace(frame_of(index, None, {"fused": ONE}), stamp_ns=stamp_ns * 100_000_000))
    assert seen.seconds == pytest.approx(0.3)
    assert sections.frame_rate(seen) == "13.3 a second"


def test_ways_are_drawn_from_the_sensors_where_they_move_nobody_knows_where_to() -> None:
    nowhere = replace(frame_of(0, None, {"fused": ONE}), T_fixed_site=None)
    unknown, adrift = ReportCollector(CONFIG, RIG), ReportCollector(CONFIG, RIG, is_adrift=True)
    unknown.add_frame(nowhere)
    adrift.add_frame(nowhere)
    assert (unknown.poses_known, unknown.is_tracked) == (0, False)
    assert (adrift.poses_known, adrift.is_tracked, adrift.travelled_m) == (1, True, 0)
    assert "1 road user" in sections.lead(adrift, NAMES)


def test_road_users_count_once() -> None:
    brief = tracked((30.0, 30.0), numbers=[7], speed=np.nan)
    seen = seen_of(ONE, brief, tracked((1.0, 2.0), (50.0, 50.0), numbers=[4, 9]))
    assert sections.lead(seen, NAMES) == "3 road users in 0.2 s: 3 \u00d7 car. 2 moved, 1 seen too briefly to tell."
    table = sections.counts(seen, NAMES)
    shown = dict(zip(table.head, *table.rows, strict=True))
    assert "car" in str(shown[""])
    assert shown.items() >= {"number": 3, "moved": 2, "stood": 0, "brief": 1, "fastest": "15.3 (4.2)"}.items()
    assert "brief" not in sections.counts(seen_of(ONE, ONE), NAMES).head


def test_the_busiest_moment_has_images_where_any_has() -> None:
    seen, many, few = ReportCollector(CONFIG, RIG), tracked((1.0, 2.0), (9.0, 9.0), numbers=[4, 5]), ONE
    for index, (source, topic) in enumerate([(many, "/lidar"), (few, "/left/image"), (few, "/left/image")]):
        one = frame_of(index, None, {"fused": source})
        seen.add_frame(replace(one, sync=FrameSync(10 + index, {topic: 0}, {})))
    assert seen.busiest is not None
    assert (seen.busiest.log_time_ns, len(seen.busiest.boxes)) == (11, 1)
    assert sections.busiest_note(seen) == "The busiest moment, 0.1 s after the first frame: 1 object."


def test_the_busiest_moment_from_above_has_all_of_its_boxes() -> None:
    boxes = source_boxes([(6.0, -9.0, 0.75, 4.0, 1.7, 1.5, 0.7)]).boxes
    points = np.random.default_rng(0).uniform(-5, 5, (500, 3))
    image = _scene_from_above(points, Moment(0.0, 0, boxes))
    is_box = (np.abs(image.astype(int) - class_color(0).bytes_rgb[::-1]) < 20).all(-1)
    assert is_box.sum() > 300
    assert not is_box[[0, -1]].any()
    assert not is_box[:, [0, -1]].any()
    red, blue = image[0, 0, 2], image[0, 0, 0]
    assert blue > red, "the ground is that of films"


def test_a_map_of_one_car_shows_what_stands_around_it() -> None:
    around = SparseGrid(0.1, 10_000)
    around.add_points(np.random.default_rng(0).uniform(-20, 20, (4000, 2)))
    low, high = map_extent([np.array([[3.0, 4.0], [3.0, 4.07]])], around)
    assert (high - low > 35).all()
    low, high = map_extent([np.array([[-50.0, 4.0], [50.0, 4.0]])], around)
    np.testing.assert_allclose([low[0], high[0]], [-62, 62])


def test_backticks_are_code() -> None:
    assert prose("try `lidcam <x>`") == "try <code>lidcam &lt;x&gt;</code>"


def test_what_was_dropped_is_listed_faults_first() -> None:
    drop = {"unit": "messages", "example": "", "is_defect": False}
    summary = {
        "drops": [
            {"topic": "/a", "reason": "no partner", "count": 2, **drop},
            {"topic": "/b", "reason": "cannot be decoded", "count": 1, **drop, "is_defect": True, "example": HOSTILE},
        ],
        "missing": [
            {"sensor": "cam0", "frames": 9, "of_frames": 20, "silences": [{"start_s": None, "end_s": 1.5}]},
            {"sensor": "slow", "frames": 10, "of_frames": 20, "silences": []},
        ],
        "unused_topics": {"/radar": 3},
        "losses": [{"file": "a.bag", "messages": None, "reason": "cut"}],
        "notes": ["a note"],
    }
    found = {table.title: table for table in sections.dropped(summary)}
    first, second = found["Dropped messages"].rows
    assert (first[0], second[0]) == ("/b", "/a")
    assert "the message is at fault: cannot be decoded" in str(first[2])
    assert HOSTILE not in str(first[2])
    assert found["Frames without a sensor"].rows == [["cam0", "9 of 20", "0.0 s to 1.5 s"]]  # not the slow one
    assert found["Topics that were not used"].notes == ["/radar (3)"]
    assert found["Damaged parts"].rows == [["a.bag", "unknown", "cut"]]
    assert found["Remarks"].notes == ["a note"]
    assert not any(table.rows or table.notes for table in sections.dropped({}))


def test_recorded_names_are_no_html() -> None:
    texts = "title result_name version lead rate against map_notes truth_note settings busiest_note film"
    lists = "headlines origin_notes truth_tables residual_tables dropped_tables origin_tables worst"
    table = PageTable([HOSTILE], [[HOSTILE]], title=HOSTILE, notes=[HOSTILE])
    content: dict[str, Any] = dict.fromkeys(texts.split(), HOSTILE) | {name: [table] for name in lists.split()}
    content |= {"busiest": [(HOSTILE, HOSTILE)], "checksums": table}
    content |= {"headlines": [HOSTILE], "origin_notes": [HOSTILE], "worst": [(HOSTILE, [(HOSTILE, HOSTILE)])]}
    content |= {"counts": table, "movements": table, "doubts": [(HOSTILE, HOSTILE, HOSTILE)]}
    figures: dict[str, Any] = {"map": {"data": [{"name": HOSTILE}], "layout": {}}}
    whole = page(figures, seen=seen_of(ONE), has_summary=True, has_zones=True, **content)
    assert HOSTILE not in whole
    assert whole.count("alert(1)") > 20
