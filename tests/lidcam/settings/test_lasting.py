"""The settings that affect a result."""

from lidcam.settings.lasting import settings_sha256
from pipeline.core.settings.load import load_config


def test_how_it_is_run_does_not_change_the_checksum_of_settings() -> None:
    base = settings_sha256(load_config("sandbox"))
    assert settings_sha256(load_config("sandbox", {"run.workers": 1})) == base
    assert settings_sha256(load_config("sandbox", {"fuse.min_score": 0.123})) != base
