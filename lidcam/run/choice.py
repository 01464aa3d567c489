"""The settings of a run: those that are given, else the preset that suits the recording."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from lidcam.pipeline.core.settings.bundled import PRESETS
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.core.text import brief
from lidcam.readers.recording import Recording
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.rig.schema import RigFile
from lidcam.readers.rig.search import zones_of
from lidcam.run.box_sources import with_device, with_network_2d
from lidcam.run.scene import SceneSize, clouds_show_motion, judge, measure_scene, scene_text

DEFAULTS = "defaults"
GIVEN = "as given"

RIVALS = {"sandbox": "road", "road": "crossing", "crossing": "road"}
"""The preset that most likely fits where the judged one is wrong."""


@dataclass(frozen=True, slots=True)
class SettingsChoice:
    """Settings before the recording is seen."""

    config: Config  # Settings that the recording is opened with, and that are used where there is no choice
    name: str = GIVEN  # Their source: a preset, a file, `defaults` or `as given`
    # The settings of each preset, among which the recording decides; empty without a choice
    by_preset: Mapping[str, Config] = field(default_factory=dict)

    __repr__ = brief


@dataclass(frozen=True, slots=True)
class UsedSettings:
    """The settings of a run and the reason for them.

    Attributes:
        name: A preset, a file, `defaults` or `as given`.
        how: `given`; `judged` from the recording; `not judged`, because its first clouds have no points.
        size: The size of the scene, if it was judged.
        moves: Whether the recording has odometry or tf of the site frame, or its clouds show that it moves.
    """

    name: str
    how: Literal["given", "judged", "not judged"]
    size: SceneSize | None = None
    moves: bool = False

    def __str__(self) -> str:
        if self.how == "not judged":
            return f"{self.name}, as there are no clouds to judge; --config {', '.join(PRESETS)} or FILE overrides"
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
    """The given settings; without any, those among which the recording decides.

    `more` overrides `settings`, which override `config`. Errors as of `load_config`.
    """

    def loaded(base: Config | str | PathLike[str] | None) -> Config:
        found = load_config(base, settings)
        return load_config(found, more) if more else found

    if config is not None:
        return SettingsChoice(loaded(config), GIVEN if isinstance(config, Config) else Path(config).name)
    return SettingsChoice(loaded(None), DEFAULTS, {name: loaded(name) for name in PRESETS})


def use_settings(
    choice: SettingsChoice, recording: Recording, found: Discovery, rig_file: RigFile | None, *, moves: bool
) -> tuple[Config, UsedSettings, Discovery]:
    """The settings of an open recording, as given or judged from its first clouds, and its sensors with the zones.

    The beginning of the recording is read where there is a choice, whatever part of it is processed. Zones
    of the rig file override those of the settings. `moves`: whether the site frame is known to move.
    """
    config, used = choice.config, UsedSettings(choice.name, "given")
    if choice.by_preset:
        size = measure_scene(recording, found.rig, choice.config)
        if size is None:
            used = UsedSettings(choice.name, "not judged")
        else:
            preset = judge(size, moves=moves)
            if preset != "road" and clouds_show_motion(recording, found.rig, choice.config):
                moves, preset = True, judge(size, moves=True)
            config, used = choice.by_preset[preset], UsedSettings(preset, "judged", size, moves)
    config = with_device(with_network_2d(config, recording, found.rig))
    return config, used, replace(found, rig=replace(found.rig, zones=zones_of(rig_file, config)))


def used_record(used: UsedSettings) -> dict[str, Any]:
    """The settings of a run for machines."""
    size: dict[str, Any] = {"extent_m": None, "lidar_height_m": None} if used.size is None else asdict(used.size)
    return {"name": used.name, "how": used.how, "moves": used.moves, **size}
