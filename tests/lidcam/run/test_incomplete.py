"""Which shortcomings of a recording count as missing: those that the user has to know of, and no others."""

from pathlib import Path

import pytest
from summaries import changed, sound_summary

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Drop
from lidcam.readers.recording import Loss
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.run.missing import damage_lines
from lidcam.run.summary import DropCount
from lidcam.run.tally import DropTable

BAG, OTHER = Path("drive.bag"), Path("a.bag")


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
