from pathlib import Path
from typing import Any

import pytest
from helpers import ROOT

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import dump_config, load_config
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS


def test_default_yaml_is_a_printed_copy_of_the_defaults() -> None:
    text = (ROOT / "config" / "default.yaml").read_text(encoding="utf-8")
    comments, _, settings = text.partition("\n\n")
    assert all(line.startswith("#") for line in comments.splitlines())
    assert settings == dump_config(Config()), "print it anew with: make config/default.yaml"


def test_settings_read_back_as_they_were_written(tmp_path: Path) -> None:
    config = load_config(None, ("sync.queue_size=7", "detect2d.model=a/b.onnx", "evaluate.min_lidar_points=0"))
    path = tmp_path / "c.yaml"
    path.write_text(dump_config(config))
    assert load_config(path) == config


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sync: {slop: 1}", r"unknown key 'sync.slop': did you mean 'sync.slop_s'\?"),
        ("fuse: {min_score_unconfirmed: 1}", r"fuse.min_score_unconfirmed is gone: fuse.min_score is a probability"),
        ("sync: {queue_size: 0}", r"sync.queue_size: expected at least 1, found 0"),
        ("- a\n- b", r"expected a mapping of sections, found list"),
        ("a: [", r"not YAML"),
        ("version https://git-lfs.github.com/spec/v1\noid", r"expected a YAML file, found a Git LFS pointer"),
    ],
)
def test_wrong_file_gets_one_line_that_helps(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_empty_file_gives_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("")
    assert load_config(path) == Config()


def test_single_values_override_the_file(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("sync: {queue_size: 3, slop_s: 0.2}")
    config = load_config(path, ("sync.queue_size=7", "combine.outliers.enabled=false", "topics.lidars=[/a, /b]"))
    assert (config.sync.queue_size, config.sync.slop_s) == (7, 0.2)
    assert not config.combine.outliers.enabled
    assert config.topics.lidars == ("/a", "/b")


def test_single_values_change_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("combine: {outliers: &off {enabled: false}, ground: *off}")
    config = load_config(path, ("combine.ground.enabled=true",))
    assert (config.combine.outliers.enabled, config.combine.ground.enabled) == (False, True)
    given = {"max_range_m": 80.0}
    assert load_config(None, {"combine": given, "combine.min_range_m": 2.0}).combine.min_range_m == 2.0
    assert given == {"max_range_m": 80.0}


def classes(*names: str, width_m: float = 2.2) -> dict[str, Any]:
    return {"classes": [{"name": name, "size_m": [4, 2, 1.5], "max_size_m": [5, width_m, 2]} for name in names]}


@pytest.mark.parametrize(
    ("settings", "fault"),
    [
        (["sync"], "sync: expected key.key=value"),
        (["=3"], "=3: expected key.key=value"),
        (["sync.slop_s.x.y=1"], "sync.slop_s: expected a number, found a section with the keys x"),
        (["sync.slop=1"], "unknown key 'sync.slop'"),
        (["run.workers=0"], "run.workers: expected at least 1, found 0"),
        *(([one], "a number, found a switch") for one in ("sync.slop_s=yes", "fuse.min_score=on", "run.workers=true")),
        (["combine.outliers.std_ratio=off"], "expected a number, found a switch"),
        (classes("car", width_m=1.8), "max_size_m: expected no less than size_m"),
        (classes("car", "car"), "a name is used twice"),
        (classes("car", " Car"), "a name is used twice"),
        (classes("all"), "'all' names the figures of all classes; expected another name"),
        (classes("Unknown"), "'unknown' is what is of no class"),
        ({"rig.zones": {"outside": [[0, 0], [1, 0], [1, 1]]}}, "'outside' names what lies in no zone"),
    ],
)
def test_wrong_settings(settings: Any, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        load_config(None, settings)


def test_limits_are_scaled_together() -> None:
    twice = load_config(None, {"limit_scale": 2}).limits
    assert (twice.max_boxes, twice.max_image_mpx, twice.max_chunk_bytes) == (4000, 100.0, 512 << 20)
    assert Config().limits == DEFAULT_LIMITS


def test_objects_may_be_of_no_class_where_that_is_asked_for() -> None:
    assert Config().object_names == Config().class_names
    assert load_config(None, {"fuse.unknown": True}).object_names == (*Config().class_names, "unknown")


def test_labels_lead_to_classes() -> None:
    config = Config()
    assert config.class_names[config.class_id_of_label["person"]] == "pedestrian"
    assert config.class_id_of_label["car"] == 0
    ((car,),) = classes("Car").values()
    capitals = load_config(None, {"classes": [car | {"labels": [" Van", "TRUCK"]}]})
    assert capitals.class_id_of_label == {"car": 0, "van": 0, "truck": 0}
    assert capitals.class_names == ("Car",)
