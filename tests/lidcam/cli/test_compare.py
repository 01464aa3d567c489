"""Comparison of results of a sample recording, and of copies of them with known faults."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import jsonschema
import pytest
from logging_state import kept_logging
from perturbed_results import Change, perturbed, turned

from lidcam.cli.compare import compare as run_compare
from lidcam.pipeline.core.errors import CheckError, LidcamError, RecordingError

ROOT = Path(__file__).parents[3]
FUSED = "/fused/detections"
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


@pytest.fixture
def faulty(result: Path, tmp_path: Path) -> Any:
    def changed(change: Change, topic: str = FUSED) -> Path:
        return perturbed(result, tmp_path / "faulty.mcap", {topic: change})

    return changed


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


def test_yaw_shifted_by_5_degrees(compare: Any, result: Path, faulty: Any) -> None:
    other = faulty(turned(5))
    found = compare(result, other)
    assert found.failures == ("fused: expected at most 0 % of the objects to differ, found 100 %",)
    assert sum("turned 5.000 deg" in line and "0-13" in line for line in found.out.splitlines()) >= 5
    assert "the first 10 of" in found.out
    counted = [line.split()[:2] for line in found.out.partition("2D boxes")[0].splitlines()]
    assert [row for row in counted if row[:1] == ["lidar"]] == [["lidar", "all"]]
    assert ["fused", "car"] in counted
    assert found.out.splitlines()[-1] == "verdict: more differences than allowed"
    tree = compare(result, other, as_json=True).tree
    counts = tree["sources"]["fused"]["all"]
    assert (counts["turned"], counts["largest_turned_deg"]) == (counts["a"], pytest.approx(5))
    assert not compare(result, other, only=("lidar",)).failures
    assert not compare(result, other, max_different=100).failures
    allowed = compare(result, other, allow=("turned",), lines=0)
    assert not allowed.failures
    assert allowed.out.splitlines()[-1] == "verdict: no more differences than allowed"
    assert "the first" not in allowed.out


def test_what_cannot_be_compared(compare: Any, result: Path) -> None:
    with pytest.raises(RecordingError, match="expected a result of lidcam, found a recording"):
        compare(result, ROOT / "bags/crossing.mcap")
    with pytest.raises(LidcamError, match=r"only: expected one of lidar, cameras, fused, camera_.*found 'fusd'"):
        compare(result, result, only=("fusd",))


def test_results_of_two_recordings_and_two_sites(compare: Any, result: Path, tmp_path: Path) -> None:
    sandbox = ROOT / "tests/golden/sandbox.mcap"
    found = compare(result, sandbox)
    assert "note: A and B are results of different recordings: crossing.mcap, sandbox.bag" in found.out

    def moved(rig: str) -> str:
        return rig.replace("site_frame: site", "site_frame: hall")

    other = perturbed(sandbox, tmp_path / "other.mcap", {}, texts={"rig.yaml": moved})
    with pytest.raises(LidcamError, match=r"other.mcap: expected objects in the frame of .*, 'site', found 'hall'"):
        compare(sandbox, other)


def test_frames_of_one_alone(compare: Any, result: Path, tmp_path: Path) -> None:
    other = perturbed(result, tmp_path / "faulty.mcap", {}, without_frames=[4, 5])
    found = compare(result, other)
    assert found.failures == ("frames: expected at most 0 % in one result alone, found 14.3 %",)
    assert "frames: 12 in both, 0 of them differ; 2 only in A, 0 only in B" in found.out
    assert not compare(result, other, allow=("frames",)).failures
