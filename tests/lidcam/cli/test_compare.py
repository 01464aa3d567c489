"""Comparison of the result of a sample recording with itself, and of small results with known differences."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jsonschema
import numpy as np
import pytest
from frames import RIG, frame, tracks_of, written_result
from helpers import CROSSING, ROOT
from logging_state import kept_logging

from lidcam.cli.compare import compare as run_compare
from lidcam.pipeline.core.errors import CheckError, LidcamError, RecordingError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.readers.rig.rig_file import rig_yaml

SCHEMA = jsonschema.Draft202012Validator(json.loads((ROOT / "docs/figures.schema.json").read_text(encoding="utf-8")))


class Outcome(NamedTuple):
    """What a comparison printed, and the lines that it failed with."""

    out: str
    failures: tuple[str, ...]

    @property
    def tree(self) -> Any:
        """The JSON, which is as the schema says."""
        found = json.loads(self.out)
        SCHEMA.validate(found)
        return found


@pytest.fixture(scope="module")
def result() -> Path:
    """The result of the sample of the crossing, without images, clouds and truth."""
    return ROOT / "tests" / "golden" / "crossing.mcap"


@pytest.fixture
def compare(capsys: pytest.CaptureFixture[str]) -> Any:
    def compared(first: Path, second: Path, **options: Any) -> Outcome:
        failures: tuple[str, ...] = ()
        try:
            with kept_logging():
                run_compare(first, second, **options)
        except CheckError as err:
            failures = err.lines
        return Outcome(capsys.readouterr().out, failures)

    return compared


def test_a_result_and_itself(compare: Any, result: Path) -> None:
    same = compare(result, result)
    assert not same.failures
    assert "frames: 14 in both, 0 of them differ; 0 only in A, 0 only in B" in same.out
    assert "difference" not in same.out
    assert same.out.splitlines()[-1] == "verdict: equal within the tolerances"
    lines = same.out.splitlines()
    counted = [line.split()[:2] for line in lines if line.startswith(("lidar", "fused", "cameras", "camera_"))]
    assert [row[1] for row in counted] == ["all"] * 7  # no class has anything to say
    tree = compare(result, result, as_json=True).tree
    assert (tree["command"], tree["exit_code"], tree["differences"]["count"]) == ("compare", 0, 0)
    assert [one["path"] for one in tree["inputs"]] == [str(result)] * 2
    channels = [*tree["sources"].values(), *tree["images"].values()]
    for counts in channels:
        assert counts["all"]["equal"] == counts["all"]["a"] == counts["all"]["b"]
    assert list(tree["sources"]) == ["lidar", "cameras", "fused"]
    assert sum(counts["all"]["equal"] for counts in channels) > 500


FRAMES = [frame(index, tracks=tracks_of([1, 2, 3])) for index in range(6)]


def turned(one: FrameResult, by_deg: float) -> FrameResult:
    """The same with another heading of the fused objects."""
    found = one.fused.objects
    objects = replace(found, yaws=wrap_angle(found.yaws + np.radians(by_deg)))
    return replace(one, fused=replace(one.fused, objects=objects))


def test_yaw_shifted_by_5_degrees(compare: Any, tmp_path: Path) -> None:
    one = written_result(tmp_path / "a.mcap", FRAMES)
    other = written_result(tmp_path / "b.mcap", [turned(one, 5) for one in FRAMES])
    found = compare(one, other)
    assert found.failures == ("fused: expected at most 0 % of the objects to differ, found 100 %",)
    assert sum("turned 5.000 deg" in line and "0-5" in line for line in found.out.splitlines()) == 3
    assert "the first 2 of 3" in compare(one, other, lines=2).out
    counted = [line.split()[:2] for line in found.out.partition("2D boxes")[0].splitlines()]
    assert [row for row in counted if row[:1] == ["lidar"]] == [["lidar", "all"]]
    assert ["fused", "car"] in counted
    assert found.out.splitlines()[-1] == "verdict: more differences than allowed"
    counts = compare(one, other, as_json=True).tree["sources"]["fused"]["all"]
    assert (counts["turned"], counts["largest_turned_deg"]) == (counts["a"], pytest.approx(5))
    assert not compare(one, other, only=("lidar",)).failures
    assert not compare(one, other, max_different=100).failures
    allowed = compare(one, other, allow=("turned",), lines=0)
    assert not allowed.failures
    assert allowed.out.splitlines()[-1] == "verdict: no more differences than allowed"
    assert "the first" not in allowed.out


def test_what_cannot_be_compared(compare: Any, result: Path) -> None:
    with pytest.raises(RecordingError, match="expected a result of lidcam, found a recording"):
        compare(result, CROSSING)
    with pytest.raises(LidcamError, match=r"only: expected one of lidar, cameras, fused, camera_.*found 'fusd'"):
        compare(result, result, only=("fusd",))


def test_results_of_two_recordings_and_two_sites(compare: Any, result: Path, tmp_path: Path) -> None:
    found = compare(result, ROOT / "tests/golden/sandbox.mcap")
    assert "note: A and B are results of different recordings: crossing.mcap, sandbox.bag" in found.out
    hall = rig_yaml(RIG).replace("site_frame: site", "site_frame: hall")
    one, other = written_result(tmp_path / "one.mcap", []), written_result(tmp_path / "other.mcap", [], rig_yaml=hall)
    with pytest.raises(LidcamError, match=r"other.mcap: expected objects in the frame of .*, 'site', found 'hall'"):
        compare(one, other)


def test_frames_of_one_alone(compare: Any, tmp_path: Path) -> None:
    one = written_result(tmp_path / "a.mcap", FRAMES)
    other = written_result(tmp_path / "b.mcap", [*FRAMES[:2], *FRAMES[4:]])
    found = compare(one, other)
    assert found.failures == ("frames: expected at most 0 % in one result alone, found 33.3 %",)
    assert "frames: 4 in both, 0 of them differ; 2 only in A, 0 only in B" in found.out
    assert not compare(one, other, allow=("frames",)).failures
