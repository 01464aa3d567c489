"""`lidcam evaluate`: its output, and how it ends."""

import json
import re
from io import BytesIO
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from frames import written_result
from helpers import CLUSTERS, ROOT, SANDBOX
from logging_state import kept_logging
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from lidcam.cli.evaluate import evaluate
from lidcam.cli.process import run_process
from lidcam.pipeline.core.errors import IncompleteError, RecordingError
from lidcam.pipeline.evaluation.labelled_part import LabelledPart, LabelledPartSearch
from lidcam.run.job import make_job

SMALL = ["output.images=false", "output.clouds=false", "output.layout=false", CLUSTERS]
SCHEMA = json.loads((ROOT / "docs" / "figures.schema.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of the sample, with its truth and without images and clouds."""
    path = tmp_path_factory.mktemp("result") / "out.mcap"
    with kept_logging():
        run_process(make_job(SANDBOX, path, config="sandbox", settings=SMALL, duration_s=0.5, workers=1))
    return path


def valid(text: str) -> dict[str, Any]:
    """A document of the schema, without the constants that JSON does not have."""

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    tree: dict[str, Any] = json.loads(text, parse_constant=refuse)
    jsonschema.Draft202012Validator(SCHEMA).validate(tree)
    return tree


def evaluated(result: Path, *requirements: str, **options: Any) -> None:
    with kept_logging():
        evaluate(result, requirements=requirements, **options)


def test_tables(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluated(result, "fused.car.recall >= 0.9", "frames > 1", everything=True)
    out = capsys.readouterr().out
    assert out.startswith(
        "out.mcap: 4 of 4 frames have ground truth, from /ground_truth/objects (by its name); 8 objects"
    )
    assert "\ndetection\nclass  source   truth  boxes  recall  prec.  false  AP bev  AP 3D   mAP\ncar    lidar" in out
    assert re.search(r"\n       cameras      8 ", out)
    assert re.search(r"\ngain from fusion, 95 % interval\nclass  over +AP bev", out)
    assert re.search(r"\ncar    (lidar|cameras) +[+-]\d\.\d\d     -   -  ", out)  # too short for an interval
    assert "  car: 0.0413, 0.0825, 0.165, 0.33 m\n" in out
    assert "\nFusion " not in out.partition("\ndetection")[0], "of 8 objects alone"
    assert "\nall " not in out  # the only class says it
    assert "fused.car.recall    >= 0.9      1  met\nframes" in out
    rows = [line for line in out.splitlines()[3:] if line[:1] != " " and ". " not in line and ": " not in line]
    assert len(rows) > 20
    assert max(map(len, rows)) <= 80


def test_json_on_standard_output(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluated(result, as_json=True)
    first = valid(capsys.readouterr().out)
    evaluated(result, as_json=True)
    second = json.loads(capsys.readouterr().out)
    assert first.pop("timing").keys() == second.pop("timing").keys()
    assert first == second


def test_settings_of_the_evaluation(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluated(result, settings=["evaluate.iou=[0.25, 0.75]", "evaluate.max_range_m=0.1"], as_json=True)
    tree = valid(capsys.readouterr().out)
    assert "ap_bev_r40_75" in tree["sources"]["fused"]["car"]
    assert "ap_bev_r40_50" not in tree["sources"]["fused"]["car"]
    assert tree["truth_objects"]["outside"] == 8
    assert [warning["subject"] for warning in tree["warnings"]] == ["truth"]


def test_truth_of_one_view(result: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(LabelledPartSearch, "add_frame", lambda *_: True)
    monkeypatch.setattr(LabelledPartSearch, "found", lambda _: LabelledPart("cam11", [[0, 0], [9, 0], [9, 9]], 0.5))
    evaluated(result)
    assert ", labelled only in the view of cam11, up to 0.5 m (evaluate.region=every" in capsys.readouterr().out
    for settings, outside in (([], 8), (["evaluate.region=everywhere"], 0)):
        evaluated(result, settings=settings, as_json=True)
        tree = valid(capsys.readouterr().out)
        assert (bool(tree["truth"]["labelled"]), tree["truth_objects"]["outside"]) == (outside > 0, outside)


@pytest.mark.parametrize(("use", "truth", "ignored"), [("count", 8, 0), ("ignore", 0, 8)])
def test_zones_of_a_rig_file(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], use: str, truth: int, ignored: int
) -> None:
    rig = tmp_path / "zones.yaml"
    corners = "[[-9, -9], [9, -9], [9, 9], [-9, 9]]"
    rig.write_text(f"zones: {{all_of_it: {{corners: {corners}, use: {use}}}}}\n", encoding="utf-8")
    required = ["fused.car.zones.all_of_it.truth == 8"] if use == "count" else []
    evaluated(result, *required, rig_files=[str(rig)], as_json=True)
    tree = valid(capsys.readouterr().out)
    figures = tree["sources"]["fused"]["car"]
    assert (figures["truth"], figures["ignored"], tree["exit_code"]) == (truth, ignored, 0)
    assert {name: zone["truth"] for name, zone in figures["zones"].items()} == ({"all_of_it": 8} if truth else {})


def test_a_result_without_frames(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"empty.mcap: expected a result with frames, found none"):
        evaluated(written_result(tmp_path / "empty.mcap", []))


def test_a_damaged_result_is_incomplete(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = bytearray((ROOT / "tests" / "golden" / "crossing.mcap").read_bytes())
    _, last = (one for one in StreamReader(BytesIO(content), emit_chunks=True).records if isinstance(one, Chunk))
    content[content.index(last.data)] ^= 0xFF  # it has a checksum
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    with pytest.raises(IncompleteError, match=r"damaged.mcap: damaged"):
        evaluated(damaged, as_json=True)
    assert valid(capsys.readouterr().out)["exit_code"] == 3
