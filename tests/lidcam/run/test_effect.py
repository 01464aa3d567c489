import pytest

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.load import load_config
from lidcam.run.effect import check_effect, settings_sha256


@pytest.mark.parametrize(
    "settings",
    [
        [],
        ["evaluate.iou=[0.5]", " classes.1.name=car", "limit_scale=2"],
        ["nothing.of=this", "", "evaluate"],  # told by those who read them
    ],
)
def test_settings_that_are_read(settings: list[str]) -> None:
    check_effect(settings)


@pytest.mark.parametrize("text", ["fuse.min_score=0.9", "fuse={}", " detect3d.x = 1"])
def test_settings_that_change_nothing(text: str) -> None:
    with pytest.raises(
        ConfigError, match=f"settings: {text.partition('=')[0].strip()}: expected a setting of evaluate"
    ):
        check_effect(["evaluate.max_range_m=5", text])


def test_how_it_is_run_does_not_change_the_checksum_of_settings() -> None:
    base = settings_sha256(load_config("sandbox"))
    assert settings_sha256(load_config("sandbox", {"run.workers": 1})) == base
    assert settings_sha256(load_config("sandbox", {"fuse.min_score": 0.123})) != base
    assert settings_sha256(load_config("sandbox", {"limit_scale": 2})) != base
