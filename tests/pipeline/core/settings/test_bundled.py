from pathlib import Path
from typing import Any

import pytest
from helpers import ROOT

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.bundled import PRESETS, bundled, settings_file
from lidcam.pipeline.core.settings.load import load_config


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_files_of_config(name: str) -> None:
    assert settings_file(name) == bundled(f"{name}.yaml")
    assert bundled(f"{name}.yaml").samefile(ROOT / "config" / f"{name}.yaml")
    load_config(name)


def test_a_preset_wins_over_a_file_without_an_ending(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sandbox").write_text("combine: {max_range_m: 7.0}")
    monkeypatch.chdir(tmp_path)
    assert load_config("sandbox").combine.max_range_m == 12.0
    assert load_config("./sandbox").combine.max_range_m == 7.0


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("snadbox", "neither: did you mean 'sandbox'?"),
        ("config/crosing.yaml", "neither: did you mean 'crossing'?"),
        ("xyz.yaml", "neither"),
        (300 * "x", "neither"),
        (7, "int"),
        ({"track": {}}, "dict; single values go into settings, as {'track.mode': 'none'}"),
    ],
)
def test_neither_a_preset_nor_a_file(name: Any, found: str) -> None:
    with pytest.raises(ConfigError) as caught:
        settings_file(name)
    named = f"{name}: " if isinstance(name, str) else ""
    assert str(caught.value) == f"{named}expected a preset (sandbox, crossing, road) or a YAML file, found {found}"
