import pytest

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.core.settings.validation import keys_of
from lidcam.run.explain import explain

KEYS = [*keys_of(Config)]


@pytest.mark.parametrize("key", KEYS)
def test_every_key_is_explained(key: str) -> None:
    found = explain(key)
    assert found.key == key
    assert found.meaning
    assert "Attributes" not in found.meaning
    assert found.keys or found.allowed


def test_a_section_names_its_keys() -> None:
    assert explain("fuse").meaning == "Fusion of matched boxes."
    assert {*explain("fuse").keys} == {*FuseConfig.model_fields}
    assert explain("fuse").keys["min_score"].startswith("Objects that are less probable are not reported.")
    assert {*explain().keys} == {*Config.model_fields}
    assert explain().keys["sync"] == "Finding the messages of one moment."
    inherited = explain("velodyne.calibration")
    assert inherited.meaning.startswith("YAML file of ROS's velodyne driver")


@pytest.mark.parametrize(
    ("key", "full"),
    [
        ("classes.size_m", "classes.*.size_m"),
        ("classes.0.size_m", "classes.*.size_m"),
        ("rig.zones.a.use", "rig.zones.*.use"),
    ],
)
def test_elements_of_lists_and_mappings(key: str, full: str) -> None:
    found = explain(key)
    assert (found.key, found.default, found.by_preset) == (full, None, {})
