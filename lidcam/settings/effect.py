"""Whether settings change anything where a result is looked at, and nothing is made anew."""

from collections.abc import Sequence

from pipeline.core.errors import ConfigError
from pipeline.core.settings.config import Config

__all__ = ["COMPARING", "EVALUATING", "check_effect"]

EVALUATING = ("evaluate", "classes", "associate", "combine", "limits")
"""The sections that an evaluation reads: of `associate` for 2D boxes without truth, of `combine` for odometry."""

COMPARING = ("compare",)
"""The section that a comparison reads."""


def check_effect(settings: Sequence[str], sections: Sequence[str]) -> None:
    """Whether each setting is one that is read; a section that no settings have is left to those who read it.

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
