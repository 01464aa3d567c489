from pathlib import Path

import pytest

from lidcam.pipeline.core.settings.bundled import PRESETS
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.run.choice import UsedSettings, choose_settings
from lidcam.run.scene import SceneSize, judge

ALLOWED = {"combine", "detect3d", "detect2d", "fuse", "classes"}


@pytest.mark.parametrize(
    ("extent_m", "height_m", "moves", "preset"),
    [
        ((5.5, 3.9), 0.26, False, "sandbox"),  # bags/sandbox.bag
        ((5.5, 3.9), 0.26, True, "road"),  # a robot in a room
        ((11.9, 3.0), 0.99, False, "sandbox"),
        ((5.0, 3.0), 1.0, False, "road"),
        ((12.5, 6.3), None, False, "road"),  # a VLP-16 in a room, no ground in view
        ((78.0, 78.0), 6.7, False, "crossing"),  # bags/crossing.mcap
        ((78.0, 78.0), 6.7, True, "road"),
        ((30.0, 30.0), 3.0, False, "road"),
        ((30.0, 30.0), 3.01, False, "crossing"),
        ((34.3, 24.5), 1.75, False, "road"),  # KITTI
    ],
)
def test_the_preset_that_suits_a_scene(
    extent_m: tuple[float, float], height_m: float | None, moves: bool, preset: str
) -> None:
    assert judge(SceneSize(extent_m, height_m), moves=moves) == preset


@pytest.mark.parametrize(
    ("used", "text"),
    [
        (UsedSettings("my.yaml", "given"), "my.yaml"),
        (
            UsedSettings("sandbox", "judged", SceneSize((9.14, 5.2), 0.5)),
            "sandbox, judged from clouds of 9.1 x 5.2 m, lidars 0.5 m above the ground; --config road overrides",
        ),
        (
            UsedSettings("defaults", "not judged"),
            "defaults, as there are no clouds to judge; --config sandbox, crossing, road or FILE overrides",
        ),
    ],
)
def test_the_line_that_tells(used: UsedSettings, text: str) -> None:
    assert str(used) == text


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_leaves_alone_what_a_recording_is_opened_with(name: str) -> None:
    """The sensors are found before the preset is chosen."""
    preset, defaults = load_config(name), Config()
    differs = {key for key in Config.model_fields if getattr(preset, key) != getattr(defaults, key)}
    assert preset.rig.site_frame == defaults.rig.site_frame
    assert preset.combine.motion == defaults.combine.motion
    assert differs - {"rig"} <= ALLOWED


def test_a_name_or_a_file_or_settings_leave_nothing_to_judge(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("fuse: {min_score: 0.5}")
    for given, name in (("crossing", "crossing"), (file, "mine.yaml"), (Config(), "as given")):
        choice = choose_settings(given)
        assert (choice.name, choice.by_preset) == (name, {})
        assert choice.config == load_config(given)


def test_single_settings_are_on_top_of_every_preset() -> None:
    choice = choose_settings(None, ["fuse.min_score=0.9"], {"run.workers": 3})
    assert {*choice.by_preset} == {*PRESETS}
    for config in (choice.config, *choice.by_preset.values()):
        assert (config.fuse.min_score, config.run.workers) == (0.9, 3)
    assert choice.by_preset["sandbox"].class_names == ("car",)
