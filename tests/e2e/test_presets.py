"""Without a flag a recording gets the settings that suit it, and `lidcam config` tells of them."""

import json
from pathlib import Path

import pytest
import yaml
from command import Lidcam
from mcap.reader import make_reader

import lidcam as library
from lidcam.report import report_tree
from pipeline.core.settings.bundled import PRESETS
from pipeline.core.settings.load import load_config

BAGS = Path(__file__).resolve().parents[2] / "bags"
JUDGED = {
    "sandbox.bag": "sandbox, judged from clouds of 5.5 x 3.9 m, lidars 0.3 m above the ground",
    "crossing.mcap": "crossing, judged from clouds of 78 x 78 m, lidars 6.7 m above the ground",
}
OVERRIDES = "; --config road overrides"


def test_the_sample_of_the_sandbox_gives_objects_without_a_flag(lidcam: Lidcam, tmp_path: Path) -> None:
    done = lidcam("process", BAGS / "sandbox.bag", tmp_path / "out.mcap")
    assert done.code == 0, done.err
    assert done.out.splitlines()[:3] == [
        "objects, sum over 20 frames",
        "class  intersection  circle  outside  all  a frame",
        "car              20      20        0   40      2.0",
    ]
    assert JUDGED["sandbox.bag"] in " ".join(done.out.split())
    assert "warning" not in done.out
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file)
        (metadata,) = (record.metadata for record in reader.iter_metadata() if record.name == "lidcam")
        (config,) = (one.data for one in reader.iter_attachments() if one.name == "lidcam.yaml")
    assert metadata["settings"] == JUDGED["sandbox.bag"] + OVERRIDES
    assert yaml.safe_load(config)["classes"][0]["size_m"] == [0.33, 0.22, 0.21]


@pytest.mark.parametrize("options", [("--start", "1", "--duration", "0.5"), ("--workers", "1", "--duration", "0.5")])
def test_the_judgement_depends_on_the_recording_alone(lidcam: Lidcam, tmp_path: Path, options: tuple[str, ...]) -> None:
    done = lidcam("process", BAGS / "sandbox.bag", tmp_path / "out.mcap", "--json", *options)
    found = json.loads(done.out)["settings"]
    assert found.pop("extent_m") == pytest.approx([5.48, 3.88], abs=0.05)
    assert found.pop("lidar_height_m") == pytest.approx(0.256, abs=0.01)
    assert len(found.pop("sha256")) == 64
    assert found == {"name": "sandbox", "how": "judged", "moves": False}


def test_the_sample_of_the_crossing_gives_what_its_settings_give(lidcam: Lidcam, tmp_path: Path) -> None:
    done = lidcam("process", BAGS / "crossing.mcap", tmp_path / "out.mcap", "--json", "--duration", "0.8")
    tree = json.loads(done.out)
    assert tree["settings"]["name"] == "crossing"
    named = library.process(BAGS / "crossing.mcap", config="crossing", duration_s=0.8).report
    assert tree["objects"] == report_tree(named)["objects"]
    assert all(entry["zone"] is None for entry in tree["objects"]), "nobody asked for zones"
    assert sum(entry["count"] for entry in tree["objects"]) > 20


@pytest.mark.parametrize("name", JUDGED)
def test_inspect_tells_what_would_be_used(lidcam: Lidcam, name: str) -> None:
    assert f"settings: {JUDGED[name]}{OVERRIDES}\n" in lidcam("inspect", BAGS / name).out


def test_inspect_tells_what_is_given(lidcam: Lidcam) -> None:
    assert "settings: road\n" in lidcam("inspect", BAGS / "sandbox.bag", "--config", "road").out


def test_from_python() -> None:
    run = library.process(BAGS / "sandbox.bag")
    assert (len(run.objects), run.report.settings.name) == (40, "sandbox")
    assert run.objects.class_names == ("car",)
    assert library.inspect(BAGS / "sandbox.bag").settings == run.report.settings
    given = library.process(BAGS / "sandbox.bag", config=library.Config(), duration_s=0.3)
    assert (len(given.objects), given.report.settings.how) == (0, "given")
    assert given.report.drops.boxes == {}, "the default classes understand the numbers of the simulator"
    (frame, *_) = library.iter_frames(BAGS / "sandbox.bag", config="sandbox", duration_s=0.3)
    assert len(frame.fused.objects)


def test_config_list(lidcam: Lidcam) -> None:
    shown = lidcam("config", "list")
    assert [line.split()[0] for line in shown.out.splitlines() if line.split()[:1] and line.split()[0] in PRESETS] == [
        *PRESETS
    ]
    assert {*json.loads(lidcam("config", "list", "--json").out)} == {*PRESETS}


@pytest.mark.parametrize("name", PRESETS)
def test_config_show(lidcam: Lidcam, tmp_path: Path, name: str) -> None:
    whole, changes = lidcam("config", "show", name), lidcam("config", "show", name, "--changes")
    for number, done in enumerate((whole, changes)):
        (tmp_path / f"{number}.yaml").write_text(done.out)
        assert load_config(tmp_path / f"{number}.yaml") == load_config(name)
    assert len(changes.out) < len(whole.out)
    assert json.loads(lidcam("config", "show", name, "--json").out)["fuse"] == yaml.safe_load(whole.out)["fuse"]


def test_config_explain(lidcam: Lidcam) -> None:
    words = " ".join(lidcam("config", "explain", "detect3d.cluster.distance_m").out.split())
    assert words == (
        "detect3d.cluster.distance_m Points nearer to each other than this belong together, close to a lidar. "
        "unit metres allowed a number above 0 default 0.4 sandbox 0.06 crossing 0.4 road 0.4"
    )
    sections = " ".join(lidcam("config", "explain").out.split())
    assert "topics Topics to use; empty means all of a suitable type." in sections
    assert json.loads(lidcam("config", "explain", "sync", "--json").out)["keys"]["policy"]
    assert "default null" in " ".join(lidcam("config", "explain", "run.window").out.split())


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("config", "show", "snadbox"), "a YAML file, found neither: did you mean 'sandbox'?"),
        (("config", "explain", "sync.polcy"), "unknown key 'sync.polcy': did you mean 'sync.policy'?"),
        (("process", "a.bag", "o.mcap", "--config", "crosing"), "found neither: did you mean 'crossing'?"),
        (
            ("process", "a.bag", "o.mcap", "--set", "topics.lidars=/points"),
            "topics.lidars: expected a list of topics, for instance [/velodyne_points], found '/points'",
        ),
        (("simulate", "sandbx", "o.bag"), "sandbox, vehicle: did you mean 'sandbox'?"),
    ],
)
def test_mistakes_are_told_with_what_was_meant(lidcam: Lidcam, arguments: tuple[str, ...], line: str) -> None:
    done = lidcam(*arguments)
    assert done.code == 1
    assert done.error_line.endswith(line)
