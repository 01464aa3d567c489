"""The settings of an open recording: as given, or judged from its first clouds."""

from dataclasses import replace

from lidcam.settings.choice import SettingsChoice, UsedSettings, judge
from lidcam.settings.measure import measure_scene
from pipeline.core.settings.config import Config
from readers.recording import Recording
from readers.rig.discovery import Discovery
from readers.rig.schema import RigFile
from readers.rig.search import zones_of

__all__ = ["settle", "with_zones"]


def settle(
    choice: SettingsChoice, recording: Recording, found: Discovery, *, moves: bool
) -> tuple[Config, UsedSettings]:
    """The settings to use, and why.

    Args:
        choice: What is given, or to choose from.
        recording: Its beginning is read where there is a choice, whatever part of it is processed.
        found: Its sensors.
        moves: Whether the site frame is known to move.

    Raises:
        RecordingError: as of `measure_scene`.
    """
    if not choice.by_preset:
        return choice.config, UsedSettings(choice.name, "given")
    size = measure_scene(recording, found.rig, choice.config)
    if size is None:
        return choice.config, UsedSettings(choice.name, "not judged")
    preset = judge(size, moves=moves)
    return choice.by_preset[preset], UsedSettings(preset, "judged", size, moves)


def with_zones(found: Discovery, rig_file: RigFile | None, config: Config) -> Discovery:
    """The sensors with the zones of the rig file, else those of the settings."""
    return replace(found, rig=replace(found.rig, zones=zones_of(rig_file, config)))
