"""Runs that are shared among processes: the outputs, the summaries and the errors of one process."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from builders import write_mcap
from helpers import CLUSTERS
from small_drive import small_drive

import lidcam
from lidcam.pipeline.core.messages import RawMessage
from lidcam.run.summary import summary_tree


@pytest.fixture(autouse=True)
def _processes_from_the_first_frame_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.pipeline.parallel.run.START_S", 0.0)


def drive(bad: tuple[int, ...] = ()) -> list[RawMessage]:
    """A vehicle that moves, with a camera that is silent for a while, and clouds that cannot be decoded."""
    messages = small_drive("cdr", frames=12, kinds=("images", "boxes"))
    clouds = [place for place, message in enumerate(messages) if message.topic == "/points"]
    for number in bad:
        whole = messages[clouds[number]]
        messages[clouds[number]] = whole._replace(data=bytes(whole.data)[:-5])
    quiet = range(messages[0].stamp_ns + 300_000_000, messages[0].stamp_ns + 600_000_000)
    return [m for m in messages if not (m.topic.startswith("/cam") and m.stamp_ns in quiet)]


def told(summary: lidcam.RunSummary) -> dict[str, Any]:
    tree = summary_tree(summary)
    assert all(milliseconds >= 0 for milliseconds in tree.pop("timing")["stage_ms"].values())
    return {**tree, "outputs": [], "warnings": [asdict(warning) for warning in summary.warnings]}


def test_same_bytes_and_same_summary(tmp_path: Path) -> None:
    write_mcap(recording := tmp_path / "drive.mcap", drive(bad=(2, 7)))
    summaries = []
    for count in (1, 2):
        out = tmp_path / f"{count}" / "out.mcap"
        out.parent.mkdir()
        summaries.append(lidcam.process(recording, out, workers=count).summary)
    assert (tmp_path / "1" / "out.mcap").read_bytes() == (tmp_path / "2" / "out.mcap").read_bytes()
    assert told(summaries[0]) == told(summaries[1])
    assert {drop.topic: drop.count for drop in summaries[1].drops.messages if drop.is_defect} == {"/points": 2}


def test_a_bad_message_ends_the_run_at_its_frame(tmp_path: Path) -> None:
    write_mcap(path := tmp_path / "drive.mcap", drive(bad=(6, 8)))
    errors, settings = [], ["track.mode=none", CLUSTERS]
    for workers in (1, 2):
        frames = lidcam.iter_frames(path, settings=settings, workers=workers, on_bad_message="fail")
        assert [next(frames).bundle.index for _ in range(6)] == list(range(6))
        with pytest.raises(lidcam.MessageError) as caught:
            next(frames)
        errors.append((str(caught.value), caught.value.__notes__))
    assert errors[0] == errors[1]
    assert "in stage decode clouds, frame 6" in errors[0][1][0]
