"""Which settings a run takes: those that are given, else the preset that suits the recording."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from lidcam.settings.measure import SceneSize
from pipeline.core.settings.bundled import PRESETS
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import load_config

__all__ = [
    "AS_GIVEN",
    "DEFAULTS",
    "GIVEN",
    "MODEL_EXTENT_M",
    "SettingsChoice",
    "UsedSettings",
    "choose_settings",
    "judge",
    "scene_text",
    "used_record",
]

DEFAULTS = "defaults"
GIVEN = "as given"

MODEL_LIDAR_M = 1.0
MODEL_EXTENT_M = 12.0
"""A model site: lidars lower than this above its ground, and clouds no longer than this. A full-size vehicle carries
its lidars higher, and even a low lidar sees further in a street."""

MAST_LIDAR_M = 3.0
"""Lidars higher than this that stand still are on masts; most vehicles are lower."""

RIVALS = {"sandbox": "road", "road": "crossing", "crossing": "road"}
"""The preset that most likely fits where the judgement is wrong."""


@dataclass(frozen=True, slots=True)
class SettingsChoice:
    """Settings before the recording is seen.

    Attributes:
        config: Settings that the recording is opened with, and that hold where there is nothing to choose.
        name: Where they come from: a preset, a file, `defaults` or `as given`.
        by_preset: The settings of each preset, among which the recording decides; empty where it does not.
    """

    config: Config
    name: str = GIVEN
    by_preset: Mapping[str, Config] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class UsedSettings:
    """The settings of a run, and why these.

    Attributes:
        name: A preset, a file, `defaults` or `as given`.
        how: `given`; `judged` from the recording; `not judged`, because its first clouds have no points.
        size: What was judged by; None if nothing was.
        moves: Whether the recording has odometry or tf of the site frame.
    """

    name: str
    how: Literal["given", "judged", "not judged"]
    size: SceneSize | None = None
    moves: bool = False

    def __str__(self) -> str:
        if self.how == "not judged":
            return f"{self.name}, for there is no cloud to judge by; --config {', '.join(PRESETS)} or FILE overrides"
        if self.size is None:
            return self.name
        seen = scene_text(self.size, moves=self.moves)
        return f"{self.name}, judged from {seen}; --config {RIVALS[self.name]} overrides"


AS_GIVEN = UsedSettings(GIVEN, "given")


def choose_settings(
    config: Config | str | PathLike[str] | None,
    settings: Mapping[str, object] | Sequence[str] = (),
    more: Mapping[str, object] | None = None,
) -> SettingsChoice:
    """The settings that are given; without any, those among which the recording decides.

    Args:
        config: Settings, the name of a preset, or a YAML file; None leaves the choice to the recording.
        settings: Single settings on top, whichever it chooses.
        more: Single settings on top of these.

    Raises:
        ConfigError: as of `load_config`.
    """

    def loaded(base: Config | str | PathLike[str] | None) -> Config:
        found = load_config(base, settings)
        return load_config(found, more) if more else found

    if config is not None:
        return SettingsChoice(loaded(config), GIVEN if isinstance(config, Config) else Path(config).name)
    return SettingsChoice(loaded(None), DEFAULTS, {name: loaded(name) for name in PRESETS})


def judge(size: SceneSize, *, moves: bool) -> str:
    """The preset that suits a scene of this size; `moves`: the site frame is known to move."""
    height_m = size.lidar_height_m
    if moves or height_m is None:
        return "road"
    if height_m < MODEL_LIDAR_M and size.extent_m[0] < MODEL_EXTENT_M:
        return "sandbox"
    return "crossing" if height_m > MAST_LIDAR_M else "road"


def scene_text(size: SceneSize, *, moves: bool) -> str:
    """The size of a scene in words."""
    length_m, width_m = size.extent_m
    digits = 1 if length_m < 10 else 0
    seen = [f"clouds of {length_m:.{digits}f} x {width_m:.{digits}f} m"]
    if size.lidar_height_m is None:
        seen.append("no ground found")
    else:
        seen.append(f"lidars {size.lidar_height_m:.1f} m above the ground")
    return ", ".join([*seen, "moving"] if moves else seen)


def used_record(used: UsedSettings) -> dict[str, Any]:
    """The settings of a run for machines."""
    size: dict[str, Any] = {"extent_m": None, "lidar_height_m": None} if used.size is None else asdict(used.size)
    return {"name": used.name, "how": used.how, "moves": used.moves, **size}
