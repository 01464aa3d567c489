"""The settings that affect a result, an evaluation or a comparison."""

from collections.abc import Sequence
from hashlib import sha256

from pipeline.core.errors import ConfigError
from pipeline.core.settings.compare import CompareConfig
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import dump_config
from pipeline.core.settings.run import RunConfig

__all__ = ["COMPARING", "EVALUATING", "check_effect", "lasting_settings", "settings_sha256"]

EVALUATING = ("evaluate", "classes", "associate", "combine", "limits")
"""The sections that an evaluation reads: of `associate` for 2D boxes without truth, of `combine` for odometry."""

COMPARING = ("compare",)
"""The section that a comparison reads."""


def check_effect(settings: Sequence[str], sections: Sequence[str]) -> None:
    """Check that each setting is read. A section that no settings have is left to those who read it.

    Args:
        settings: Single settings, `["evaluate.iou=[0.5]"]`.
        sections: The sections that are read.

    Raises:
        ConfigError: one would change nothing.
    """
    for text in settings:
        key = text.partition("=")[0].strip()
        section = key.partition(".")[0]
        if section in Config.model_fields and section not in sections:
            raise ConfigError(
                f"settings: {key}: expected a setting of {', '.join(sections)}, found one that changes nothing in a "
                "result that is there; give it to `lidcam process`"
            )


def lasting_settings(config: Config) -> str:
    """All settings that affect a result, as YAML: how it is run or compared with another one does not."""
    return dump_config(config.model_copy(update={"run": RunConfig(), "compare": CompareConfig()}))


def settings_sha256(config: Config) -> str:
    """Checksum of all settings that affect a result, the same as in the metadata of an output (`config.sha256`)."""
    return sha256(lasting_settings(config).encode()).hexdigest()
