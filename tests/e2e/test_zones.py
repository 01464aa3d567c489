"""What zones are for, end to end: counted, reported alone, or left out, and nothing lost silently."""

from pathlib import Path
from typing import Any

from helpers import SANDBOX
from results import fused_objects, messages_of
from summaries import printed

from lidcam.processing import process_recording
from lidcam.run.job import make_job
from lidcam.run.summary import RunSummary, summary_tree

SOUTH = [[-99, -99], [99, -99], [99, 0], [-99, 0]]
SETTINGS = {
    "output.images": False,
    "output.clouds": False,
    "output.layout": False,
    "fuse.min_score": 0.1,
    "detect3d.method": "cluster",
    "track.mode": "online",  # offline, what is left out counts for the usual length of the others
}


def process(out: Path, **zones: Any) -> RunSummary:
    job = make_job(SANDBOX, out, config="sandbox", settings={**SETTINGS, "rig.zones": zones}, duration_s=0.3, workers=1)
    return process_recording(job)


def test_objects_that_are_not_reported_are_counted(tmp_path: Path) -> None:
    plain, reason = tmp_path / "plain.mcap", "outside of all zones of use detect"
    process(plain)
    summary = process(tmp_path / "out.mcap", south={"corners": SOUTH, "use": "detect"})
    before, after = fused_objects(plain), fused_objects(tmp_path / "out.mcap")
    kept = {stamp: [one for one in objects if one.y <= 0] for stamp, objects in before.items()}
    assert after == kept
    left_out = sum(map(len, before.values())) - sum(map(len, kept.values()))
    assert left_out > 0
    assert dict(summary.drops.objects) == {reason: left_out}
    assert summary_tree(summary)["objects_left_out"] == {reason: left_out}
    assert {zone for _, zone in summary.frames.objects} == {"south"}
    assert f"{left_out} detections dropped: {reason}" in printed(summary)
    for topic in ("/lidar/detections", "/cameras/detections"):
        one, other = (messages_of(path, topic) for path in (plain, tmp_path / "out.mcap"))
        assert [len(message.detections) for _, message in one] == [len(message.detections) for _, message in other]
