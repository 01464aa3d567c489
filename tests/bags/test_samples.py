"""The sample recordings are the ones that their README describes."""

import hashlib
import shlex
from itertools import pairwise

import pytest
import yaml
from helpers import BAGS, ROOT
from mcap.reader import make_reader

from lidcam.bags.simulator.scenario.scenario import Scenario, load_scenario

README = (BAGS / "README.md").read_text(encoding="utf-8")
SAMPLES = ["sandbox.bag", "crossing.mcap"]


def scenario_of(name: str) -> Scenario:
    """What a recording says that it was recorded from."""
    path = BAGS / name
    if path.suffix == ".bag":
        text = path.with_name(f"{name}.scenario.yaml").read_text(encoding="utf-8")
    else:
        with path.open("rb") as stream:
            attached = {one.name: one.data for one in make_reader(stream).iter_attachments()}
        text = attached["scenario.yaml"].decode()
    return Scenario.model_validate(yaml.safe_load(text))


@pytest.mark.parametrize("name", SAMPLES)
def test_readme_tells_size_and_hash(name: str) -> None:
    data = (BAGS / name).read_bytes()
    [row] = [line for line in README.splitlines() if line.startswith(f"| `{name}` |")]
    assert f"{len(data)} bytes" in row
    assert hashlib.sha256(data).hexdigest() in row


@pytest.mark.parametrize("name", SAMPLES)
def test_the_command_in_the_readme_is_the_one_that_recorded_it(name: str) -> None:
    [command] = [line for line in README.splitlines() if line.startswith("lidcam simulate ") and f"bags/{name}" in line]
    assert f"\t$(BIN)/{command}" in (ROOT / "Makefile").read_text(encoding="utf-8")
    arguments = shlex.split(command)
    overrides = [value for key, value in pairwise(arguments) if key == "--set"]
    duration_s = float(arguments[arguments.index("--duration") + 1])
    asked_for = load_scenario(arguments[2], tuple(overrides)).model_copy(update={"duration_s": duration_s})
    assert asked_for == scenario_of(name)
