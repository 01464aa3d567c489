"""Without a flag a recording gets the settings that suit it, and `lidcam config` tells of them."""

import json
from pathlib import Path

import pytest
import yaml
from command import Lidcam
from helpers import BAGS, CROSSING, SANDBOX
from mcap.reader import make_reader

import lidcam as library
from lidcam.pipeline.core.settings.bundled import PRESETS
from lidcam.pipeline.core.settings.load import load_config
from lidcam.run.summary import summary_tree

JUDGED = {
    "sandbox.bag": "sandbox, judged from clouds of 5.5 x 3.9 m, lidars 0.3 m above the ground",
    "crossing.mcap": "crossing, judged from clouds of 78 x 78 m, lidars 6.7 m above the ground",
}
OVERRIDES = "; --config road overrides"


def test_the_sample_of_the_sandbox_gives_objects_without_a_flag(lidcam: Lidcam, tmp_path: Path) -> None:
    done = lidcam("process", SANDBOX, tmp_path / "out.mcap", "--duration", "0.3", "-v")
    assert done.code == 0, done.err
    assert "\nobjects, sum over 2 frames\n" in done.out
    assert JUDGED["sandbox.bag"] in " ".join(done.out.split())
    assert "warning" not in done.out
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file)
        (metadata,) = (record.metadata for record in reader.iter_metadata() if record.name == "lidcam")
        (config,) = (one.data for one in reader.iter_attachments() if one.name == "lidcam.yaml")
    assert metadata["settings"] == JUDGED["sandbox.bag"] + OVERRIDES
    assert yaml.safe_load(config)["classes"][0]["size_m"] == [0.33, 0.22, 0.21]


def test_the_sample_of_the_crossing_gives_what_its_settings_give(lidcam: Lidcam, tmp_path: Path) -> None:
    done = lidcam("process", CROSSING, tmp_path / "out.mcap", "--json", "--duration", "0.4")
    tree = json.loads(done.out)
    assert tree["settings"]["name"] == "crossing"
    named = library.process(CROSSING, config="crossing", duration_s=0.4).summary
    assert tree["objects"] == summary_tree(named)["objects"]
    assert all(entry["zone"] is None for entry in tree["objects"]), "nobody asked for zones"
    assert sum(entry["count"] for entry in tree["objects"]) > 8


@pytest.mark.parametrize("name", JUDGED)
def test_inspect_tells_what_would_be_used(lidcam: Lidcam, name: str) -> None:
    assert f"settings: {JUDGED[name]}{OVERRIDES}\n" in lidcam("inspect", BAGS / name).out
    assert "settings: road\n" in lidcam("inspect", BAGS / name, "--config", "road").out


def test_config(lidcam: Lidcam, tmp_path: Path) -> None:
    assert {*json.loads(lidcam("config", "list", "--json").out)} == {*PRESETS}
    shown = [line.split()[0] for line in lidcam("config", "list").out.splitlines() if line.strip()]
    assert [name for name in shown if name in PRESETS] == [*PRESETS]
    for name in PRESETS:
        whole, changes = lidcam("config", "show", name), lidcam("config", "show", name, "--changes")
        for done in (whole, changes):
            (tmp_path / "shown.yaml").write_text(done.out)
            assert load_config(tmp_path / "shown.yaml") == load_config(name)
        assert len(changes.out) < len(whole.out)
        assert json.loads(lidcam("config", "show", name, "--json").out)["fuse"] == yaml.safe_load(whole.out)["fuse"]
        asked = json.loads(lidcam("config", "show", name, "--changes", "--json").out)
        assert asked.keys() == yaml.safe_load(changes.out).keys()
    words = " ".join(lidcam("config", "explain", "detect3d.cluster.distance_m").out.split())
    assert words == (
        "detect3d.cluster.distance_m Points nearer to each other than this belong together, close to a lidar. "
        "unit metres allowed number, above 0 default 0.4 sandbox 0.06 crossing 0.4 road 0.4"
    )
    assert json.loads(lidcam("config", "explain", "sync", "--json").out)["keys"]["slop_s"]
    which = "did you mean 'detect3d.min_score' or 'detect2d.min_score' or 'fuse.min_score'?"
    assert lidcam("config", "explain", "min_score").error_line.endswith(which)
