"""Figures of a result through the installed command, and the workflow that users copy."""

import json
import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from builders import in_order, write_rosbag1
from command import Lidcam, shell
from helpers import CLUSTERS, ROOT, SANDBOX

from lidcam.pipeline.core.messages import RawMessage

WORKFLOW = ROOT / "docs" / "workflow.yml"
BUCKET_WORKFLOW = WORKFLOW.with_name("bucket-workflow.yml")
PART = ("--duration", "0.4", "--set", CLUSTERS)


@pytest.fixture(scope="module")
def result(lidcam: Lidcam, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("result") / "out.mcap"
    assert lidcam("process", SANDBOX, path, "--config", "sandbox", *PART).code == 0
    return path


def test_requirements_that_are_met_and_not(lidcam: Lidcam, result: Path, tmp_path: Path) -> None:
    gate = tmp_path / "gate.txt"
    gate.write_text(
        "fused.car.recall > 2  # cannot be\nframes > 100\nfused.car.ap_bev_r40_50 > 0.1\n", encoding="utf-8"
    )
    missed = lidcam("evaluate", result, "--require", f"@{gate}", "--json-file", tmp_path / "figures.json")
    assert missed.code == 1
    assert re.fullmatch(
        r"lidcam: error: fused\.car\.recall: expected > 2, found [\d.]+\n"
        r"lidcam: error: frames: expected > 100, found \d\n",
        missed.err.removeprefix(f"wrote {tmp_path / 'figures.json'}\n"),
    )
    assert "fused  truth  recall" in missed.out
    tree = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert [outcome["is_met"] for outcome in tree["requirements"]] == [False, False, True]
    renamed = gate.rename(tmp_path / "gate.json")  # a gate, and not the place for figures
    refused = lidcam("evaluate", result, "--require", f"@{renamed}", "--json-file", renamed, "--overwrite")
    assert refused.code == 1
    assert "gate.json: is an input of this run" in refused.error_line
    unknown = lidcam("evaluate", result, "--require", "fused.car.recal >= 0.9")
    assert unknown.code == 2
    assert "'fused.car.recal': did you mean 'fused.car.recall'?" in " ".join(unknown.err.split())


def steps(path: Path = WORKFLOW) -> Iterator[dict[str, Any]]:
    workflow = yaml.safe_load(path.read_text(encoding="utf-8"))
    for job in workflow["jobs"].values():
        yield from job["steps"]


@pytest.mark.parametrize("path", [WORKFLOW, BUCKET_WORKFLOW], ids=lambda path: path.name)
def test_a_workflow_pins_what_it_uses(path: Path) -> None:
    used = [step["uses"] for step in steps(path) if "uses" in step]
    assert len(used) >= 3
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", one) for one in used)


@pytest.mark.slow
def test_the_workflow_runs(first_messages: dict[str, list[RawMessage]], tmp_path: Path) -> None:
    """All steps but the installation, in the shell that GitHub takes."""
    samples = tmp_path / "samples"
    samples.mkdir()
    write_rosbag1(samples / "drive.bag", in_order(*first_messages.values()))
    shutil.copy(ROOT / "config" / "sandbox.yaml", samples / "site.yaml")
    (samples / "gate.txt").write_text("fused.car.recall >= 0.5\n", encoding="utf-8")
    shutil.copy(SANDBOX.with_name(f"{SANDBOX.name}.rig.yaml"), samples / "rig.yaml")
    text = WORKFLOW.read_text(encoding="utf-8")
    golden = " ".join(re.findall(r"#     (lidcam process .*)\\\n#       (.*)\n", text)[0])
    commands = [step["run"] for step in steps() if "run" in step]
    assert commands[0].startswith("pip install lidcam==")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for command in (golden, *commands[1:]):
        done = shell(command, tmp_path, PATH=path)
        assert done.code == 0, f"{command}\n{done.err}"
    assert (tmp_path / "figures.json").is_file()
