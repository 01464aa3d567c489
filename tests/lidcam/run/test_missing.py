from pathlib import Path

import pytest
from frames import RIG
from summaries import changed, sound_summary

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.stages.sync.attendance import Absence, Silence
from lidcam.readers.recording import Loss
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.run.missing import (
    MissingSensor,
    SilentSpan,
    absence_warnings,
    damage_lines,
    missing_sensors,
    silence_warnings,
)
from lidcam.run.summary import DropCount
from lidcam.run.tally import DropTable

BAG, OTHER = Path("drive.bag"), Path("a.bag")
S = 10**9
START_NS = 1_700_000_000 * S


@pytest.mark.parametrize(
    ("silences", "alive", "text"),
    [
        ([(1.0, None)], 0, "silent from 1.0 s to the end"),
        ([(None, None)], 0, "silent throughout"),
        ([], 15, "in 15 of 30 frames"),
        ([(1.0, 1.5)], 2, "silent from 1.0 s to 1.5 s; in 2 of 30 frames"),
        (
            [(1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (7.0, None)],
            0,
            "silent from 1.0 s to 2.0 s, silent from 3.0 s to 4.0 s, silent from 5.0 s to 6.0 s and 1 times more",
        ),
    ],
)
def test_what_is_said(silences: list[tuple[float | None, float | None]], alive: int, text: str) -> None:
    spans = tuple(SilentSpan(start_s, end_s, 3) for start_s, end_s in silences)
    assert str(MissingSensor("cam", "/cam", alive + 3 * len(spans), 30, spans)) == text


def test_absences_become_sensors_and_silences_warnings() -> None:
    absences = [
        Absence("/lidar2", 5, (Silence(START_NS + S, None, 5),)),
        Absence("/left/image", 2, ()),
        Absence("/right/image", 9, (Silence(None, START_NS + 2 * S, 4),)),
    ]
    missing = missing_sensors(absences, RIG, of_frames=10, start_ns=START_NS)
    assert [(m.sensor, m.topic, m.frames, str(m)) for m in missing] == [
        ("lidar2", "/lidar2", 5, "silent from 1.0 s to the end"),
        ("left", "/left/image", 2, "in 2 of 10 frames"),
        ("right", "/right/image", 9, "silent until 2.0 s; in 5 of 10 frames"),
    ]
    assert list(map(str, silence_warnings(missing))) == [
        "lidar2: silent from 1.0 s to the end; 5 of 10 frames lack it; "
        "check the sensor, its driver and the recording of /lidar2",
        "right: silent until 2.0 s; 4 of 10 frames lack it; check the sensor, its driver and the recording of "
        "/right/image",
    ]


def test_sensors_that_fall_silent_together_share_a_warning() -> None:
    span = (SilentSpan(1.0, None, 20),)
    missing = [MissingSensor(name, f"/{name}", 20, 30, span) for name in ("cam1", "cam2", "cam2 (boxes)")]
    missing.append(MissingSensor("cam3", "/cam3", 20, 30, (SilentSpan(1.5, None, 20),)))
    assert list(map(str, silence_warnings(missing))) == [
        "cam1, cam2: silent from 1.0 s to the end; 20 of 30 frames lack them; check what they share: power, network, "
        "driver, or the recorder",
        "cam3: silent from 1.5 s to the end; 20 of 30 frames lack it; check the sensor, its driver and the recording "
        "of /cam3",
    ]
    assert silence_warnings([]) == []
    outside = MissingSensor("cam4", "/cam4", 30, 30, (SilentSpan(None, None, 30),))
    assert "lack it; the messages of /cam4 lie at other times" in str(silence_warnings([outside])[0])
    boxes_alone = [MissingSensor("cam2", "/cam2", 3, 9, ()), missing[2]]
    assert [warning.subject for warning in silence_warnings(boxes_alone)] == ["cam2 (boxes)"]


def absent(*names: str, frames: int = 20) -> list[MissingSensor]:
    return [MissingSensor(name, f"/{name}", frames, 20, ()) for name in names]


@pytest.mark.parametrize(
    ("missing", "sensors"),
    [
        ([], []),
        (absent("left", frames=19), []),
        (absent("left", "left (boxes)", "other (boxes)"), ["left", "other (boxes)"]),
        ([MissingSensor("left", "/left/image", 20, 20, (SilentSpan(None, None, 20),))], []),  # said as silence
        ([MissingSensor("left", "/left/image", 20, 20, (SilentSpan(1.0, None, 12),))], ["left"]),
    ],
)
def test_sensors_that_no_frame_has_are_named(missing: list[MissingSensor], sensors: list[str]) -> None:
    assert [warning.subject for warning in absence_warnings(missing, {})] == sensors


@pytest.mark.parametrize(
    ("losses", "lines"),
    [
        ([], []),
        ([Loss(BAG, 0, "the recorder did not close it; completed from drive.bag-wal in a copy", messages=0)], []),
        ([Loss(BAG, 0, "x", messages=1), Loss(BAG, 9, "y", messages=30)], ["drive.bag: damaged, 31 messages lost"]),
        ([Loss(BAG, 0, "x"), Loss(BAG, 9, "x", messages=2)], ["drive.bag: damaged, 2 messages or more lost"]),
        (
            [Loss(BAG, 0, "x", messages=4), Loss(OTHER, 0, "x", messages=0), Loss(OTHER, 3, "x")],
            ["a.bag: damaged, an unknown number of messages lost", "drive.bag: damaged, 4 messages lost"],
        ),
    ],
)
def test_damage_counts_where_messages_may_be_lost(losses: list[Loss], lines: list[str]) -> None:
    assert damage_lines(losses) == lines


def test_a_report_says_what_is_missing() -> None:
    assert sound_summary().incomplete == ()
    drops = (DropCount("/a", "too late", 7, ""), DropCount("/a", "cannot be decoded", 3, "", is_defect=True))
    found = changed(
        sound_summary(),
        drops={"messages": drops},
        sensors={"faults": (SensorFault("cam1", "/cam1/image", "x"), SensorFault("cam2", "", "no topic is left"))},
        inputs={"losses": (Loss(BAG, 0, "x", messages=2),)},
    )
    assert found.incomplete == (
        "cam1 (/cam1/image) is left out",
        "cam2 is left out",
        "/a: 3 messages dropped: cannot be decoded",
        "drive.bag: damaged, 2 messages lost",
    )


def test_drops_tell_defects_from_messages_that_were_not_needed() -> None:
    table = DropTable()
    table.count_drop(Drop("/a", 1, "too late"))
    table.count_defect(Drop("/a", 2, "its stamp is 0"))
    table.count_bad(Drop("/a", 3, "cannot be decoded"))
    defects = {row.reason: row.is_defect for row in table.rows}
    assert defects == {"cannot be decoded": True, "its stamp is 0": True, "too late": False}
    with pytest.raises(MessageError, match="/a: cannot be decoded"):
        DropTable("fail").count_bad(Drop("/a", 3, "cannot be decoded"))
