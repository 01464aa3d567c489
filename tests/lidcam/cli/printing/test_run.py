"""The dozen lines after a run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from summaries import changed, printed, sound_summary

from lidcam.cli.printing.numbers import Units
from lidcam.pipeline.evaluation.road_users import RoadUserCount, RoadUsers
from lidcam.run.box_sources import ADVICE
from lidcam.run.missing import MissingSensor
from lidcam.run.summary import DropCount, RunSummary
from lidcam.run.warning import RunWarning

CARS = RoadUserCount("car", "", 7, 3, 2, 10.0, 20.0)
PARKED = RoadUserCount("truck", "", 2, 0, 2, np.nan, np.nan)
DROP = DropCount("/image", "no partner within 0.05 s", 3, "")


def short(units: Units = "km/h", **changes: object) -> list[str]:
    summary: RunSummary = replace(sound_summary(), **changes)  # type: ignore[arg-type]  # of any field
    return printed(summary, details=False, units=units).splitlines()


@pytest.mark.parametrize(
    ("units", "mean", "highest"), [("km/h", "36.0", "72.0"), ("m/s", "10.0", "20.0"), ("mph", "22.4", "44.7")]
)
def test_who_moved_and_who_stood(units: Units, mean: str, highest: str) -> None:
    header, cars, trucks = short(units, road_users=RoadUsers((CARS, PARKED), ()))[2:5]
    assert header.startswith(f"road users  moved  stood  brief  mean {units}  max {units}")
    assert cars.split() == ["car", "3", "2", "2", mean, highest, "0", "0"]
    assert trucks.split() == ["truck", "0", "2", "0", "0", "0"], "no speeds of what stands"


def test_road_users_by_zone() -> None:
    users = RoadUsers((replace(CARS, zone="circle", count=4), replace(CARS, moved=5)), ())
    header, cars = short(road_users=users)[2:4]
    assert header.split()[-2:] == ["intersection", "circle"]
    assert "brief" not in header
    assert cars.split()[-2:] == ["0", "4"]


def test_without_tracks_and_without_any() -> None:
    assert short(road_users=None)[2] == "objects per frame: car 2.0"
    assert short(road_users=RoadUsers((), ()))[2] == "no road users"


def test_runs_take_a_dozen_lines() -> None:
    many = [replace(CARS, class_name=name) for name in ("car", "pedestrian", "bicycle", "truck", "bus")]
    outputs = tuple(Path("a drive.lidcam") / f"a drive{ending}" for ending in (".mcap", ".rrd", ".foxglove.json"))
    lines = short(road_users=RoadUsers(tuple(many), ()), outputs=(*outputs, Path("other.html"), Path("film.mp4")))
    assert len(lines) <= 12
    assert lines[-2:] == [
        "wrote a drive.lidcam/a drive.mcap, .rrd, .foxglove.json, other.html, film.mp4",
        "to look at it: lidcam view 'a drive.lidcam/a drive.rrd' (or other.html, .mcap, film.mp4)",
    ]

    # As 3 s of a street without a 2D network, on a terminal.
    boxes = "11 pedestrian, 13 bus boxes score 0.2 to 0.5, below it"
    warning = RunWarning("fuse.min_score", boxes, "use --model-2d to tell which are right")
    summary = changed(sound_summary(), sensors={"box_words": ("none (lidar-only); a network", ADVICE)})
    summary = replace(summary, outputs=outputs, warnings=(warning,), road_users=RoadUsers((CARS, PARKED), ()))
    lines = printed(summary, details=False, width=80).splitlines()
    assert len(lines) <= 12
    assert "".join(lines[-2:]).endswith("lidcam view 'a drive.lidcam/a drive.rrd' (or .mcap)")


def test_what_was_dropped_and_what_is_missing() -> None:
    summary = changed(
        sound_summary(),
        drops={"messages": (DROP, replace(DROP, topic="/points", unit="parts"))},
        sensors={"missing": (MissingSensor("cam", "/image", 2, 4, ()),)},
        inputs={"copied": {"/truth/a": 2, "/truth/b": 3}},
    )
    assert "5 messages: /truth/* (2 topics)\n" in printed(summary)
    text = printed(summary, details=False)
    assert "dropped: 3 messages of /image: no partner within 0.05 s\n" in text
    assert "/points" not in text, "parts of messages that were used"
    assert f"missing: cam in 2 of {summary.frames.count} frames; -v says when" in text
    some = tuple(
        MissingSensor(f"{name}cam", "/image", count, 4, ())
        for name, count in zip("abcde", (2, 1, 2, 2, 1), strict=True)
    )
    line = printed(changed(summary, sensors={"missing": some}), details=False).splitlines()[-1]
    assert line.startswith("missing: bcam and ecam in 1, 3 topics in 2 of ")
    slow, few = (MissingSensor(name, f"/{name}", count, 9, ()) for name, count in (("slow", 3), ("few", 2)))
    lines = printed(changed(summary, sensors={"missing": (slow, few)}), details=False).splitlines()
    frames = summary.frames.count
    assert f"slower sensors: slow in {frames - 3} of {frames} frames; -v says when" in lines
    assert f"missing: few in 2 of {frames} frames; -v says when" in lines
    both = changed(summary, drops={"messages": (DROP, replace(DROP, topic="/other"))})
    assert "dropped: 6 messages of 2 topics: no partner within 0.05 s\n" in printed(both, details=False)


def test_the_first_warnings_and_the_last() -> None:
    warnings = [RunWarning(f"sensor {n}", "is late", "wait") for n in range(5)]
    text = printed(replace(sound_summary(), warnings=tuple(warnings)), details=False)
    assert "sensor 1: is late; wait\nand 2 more warnings, with -v\nwarning: sensor 4: is late; wait" in text
