"""A run as a value: everything it needs to know, nothing open. It can be pickled, and run in another process."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Unpack, get_args

from lidcam.pipeline.core.errors import CalibrationError, ConfigError, OutputError
from lidcam.pipeline.core.settings.bundled import bundled, preset_or_file
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.validation import did_you_mean
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.detectors.given import LIDCAMS_OWN, GivenDetectors
from lidcam.readers.location import Location, RemotePath, location
from lidcam.readers.rig.rig_file import load_rig, merge_rigs
from lidcam.readers.rig.schema import RigFile
from lidcam.run.choice import SettingsChoice, choose_settings
from lidcam.run.effect import named_files
from lidcam.run.options import DEFAULTS, JobOptions, OnBadMessage, with_job_keywords

DEFAULT_SETTINGS = SettingsChoice(Config())

FilePath = str | PathLike[str]
PathOrUrl = FilePath | RemotePath
Settings = Mapping[str, object] | Sequence[str]
RigSource = RigFile | FilePath | Sequence[RigFile | FilePath]
"""A rig file, loaded, by path or by name of a preset; or several, where later ones add and replace."""


@dataclass(frozen=True, slots=True)
class Job:
    """One recording to process; `JobOptions` explains what is not explained here.

    Attributes:
        inputs: A recording, or all parts of a split one in order.
        outputs: Files to write, and a folder; the endings of their names select the kinds
            (`lidcam.outputs.registry.OUTPUTS`).
        settings: The settings, or those among which the recording decides.
        rig: All rig files together; what it leaves out is found in the recording.
        read_files: Other files that are read: settings, rig files, a network. No output may replace them.
        foxglove: Host and port at which frames are served; None: they are not.
        given: Functions of the caller that find boxes.
    """

    inputs: tuple[Location, ...]
    outputs: tuple[Path, ...] = ()
    settings: SettingsChoice = DEFAULT_SETTINGS
    rig: RigFile | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    on_bad_message: OnBadMessage = "skip"
    overwrite: bool = False
    read_files: tuple[Path, ...] = ()
    view: bool = False
    foxglove: tuple[str, int] | None = None
    pace: float | None = None
    given: GivenDetectors = LIDCAMS_OWN

    __repr__ = brief

    def __post_init__(self) -> None:
        if not 0 <= self.start_s < inf:
            raise ConfigError(f"start_s: expected 0 s or more, found {self.start_s}")
        if self.duration_s is not None and not 0 < self.duration_s < inf:
            raise ConfigError(f"duration_s: expected more than 0 s, found {self.duration_s}")
        if self.on_bad_message not in get_args(OnBadMessage):
            raise ConfigError(f"on_bad_message: expected skip or fail, found {self.on_bad_message!r}")
        if self.pace is not None and not 0 < self.pace < inf:
            raise ConfigError(f"pace: expected more than 0, found {self.pace}")
        for keyword, section, find in (
            ("detector", "detect3d", self.given.in_cloud),
            ("detector_2d", "detect2d", self.given.in_images),
        ):
            method = getattr(self.config, section).method
            if (find is None) != (method != "callable"):
                raise ConfigError(f"{section}.method {method}: it is `callable` if {keyword} is given, and only then")

    @property
    def config(self) -> Config:
        """The settings; where the recording decides, those that it is opened with."""
        return self.settings.config


ALL_OPTIONS = tuple(JobOptions.__annotations__)

SETTINGS_OF_OPTIONS = {
    "model_2d": ["detect2d.model"],
    "model_3d": ["detect3d.model"],
    "device": ["detect2d.provider", "detect3d.provider"],
    "copy_topics": ["output.copy_topics"],
    "workers": ["run.workers"],
    "every": ["sync.every"],
}
"""Options that set settings."""


def check_options(given: Iterable[str], known: Any, function: str) -> None:
    """Check that all options are of this typed dictionary; raises TypeError."""
    names = known.__annotations__
    if unknown := [name for name in given if name not in names]:
        hint = did_you_mean(unknown[0], [*names])
        raise TypeError(f"expected options of {function}, got {', '.join(unknown)}{hint}")


@with_job_keywords(*ALL_OPTIONS)
def make_job(
    recording: PathOrUrl | Sequence[PathOrUrl],
    output: FilePath | Sequence[FilePath] | None = None,
    **options: Unpack[JobOptions],
) -> Job:
    """A job, with its settings and its rig file read: a value that can be pickled and run later.

    Args:
        recording: As in `lidcam.process`.
        output: As in `lidcam.process`.
        **options: See `JobOptions`.

    Raises:
        ConfigError: the settings cannot be read or do not fit, or the part of the recording is not one.
        CalibrationError: the rig file cannot be read or does not fit.
        OutputError: an output is not a local file.
    """
    check_options(options, JobOptions, "lidcam.process")
    outputs = locations([] if output is None else output)
    if remote := [path for path in outputs if isinstance(path, RemotePath)]:
        raise OutputError(f"{remote[0]}: expected the name of a local file as output")
    options = {**DEFAULTS, **options}
    given = _given_detectors(options)
    values: dict[str, object] = {key: options.get(name) for name, keys in SETTINGS_OF_OPTIONS.items() for key in keys}
    values |= {"detect3d.method": given.in_cloud and "callable", "detect2d.method": given.in_images and "callable"}
    more = {key: value for key, value in values.items() if value is not None}
    choice = choose_settings(options.get("config"), options["settings"], more)
    foxglove, save_matches = options.get("foxglove"), options.get("save_matches")
    folders = [] if save_matches is None else [Path(save_matches)]
    return Job(
        inputs=locations(recording),
        outputs=(*(path for path in outputs if isinstance(path, Path)), *folders),
        settings=choice,
        rig=read_rig(options.get("rig")),
        start_s=options["start_s"],
        duration_s=options.get("duration_s"),
        on_bad_message=options["on_bad_message"],
        overwrite=options["overwrite"],
        read_files=read_files(options.get("config"), options.get("rig"), *named_files(choice.config).values()),
        view=options["view"],
        foxglove=None if foxglove is None else _served_address(str(foxglove)),
        pace=options.get("pace"),
        given=given,
    )


def _given_detectors(options: JobOptions) -> GivenDetectors:
    in_cloud, in_images = options.get("detector"), options.get("detector_2d")
    for keyword, find, model in (("detector", in_cloud, "model_3d"), ("detector_2d", in_images, "model_2d")):
        if find is not None and not callable(find):
            raise ConfigError(f"{keyword}: expected a function, found {type(find).__name__}")
        if find is not None and options.get(model) is not None:
            raise ConfigError(f"expected one of {keyword} and {model}, found both")
    return GivenDetectors(in_cloud, in_images)


def _served_address(text: str) -> tuple[str, int]:
    """Host and port of `8765`, `0.0.0.0:8765` or `[::1]:8765`; the default host is this machine alone."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) < 1 << 16):
        raise ConfigError(f"foxglove: expected PORT or HOST:PORT, found {text!r}")
    return host.removeprefix("[").removesuffix("]") or "127.0.0.1", int(port)


def locations(recording: PathOrUrl | Sequence[PathOrUrl]) -> tuple[Location, ...]:
    """The locations of the files of a recording."""
    given = [recording] if isinstance(recording, str | PathLike | RemotePath) else recording
    return tuple(one if isinstance(one, RemotePath) else location(fspath(one)) for one in given)


def read_files(config: Config | FilePath | None, rig: RigSource | None, *named: Path) -> tuple[Path, ...]:
    """The files among the settings, the rig files, and the files that the settings name."""
    rigs = [rig] if rig is None or isinstance(rig, RigFile | str | PathLike) else rig
    paths = [Path(one) for one in (config, *rigs, *named) if isinstance(one, str | PathLike)]
    return tuple(path for path in paths if os.access(path, os.R_OK) and path.is_file())


def read_rig(rig: RigSource | None) -> RigFile | None:
    """Rig files, loaded, by their paths or by the names of presets, as one.

    Raises:
        CalibrationError: one cannot be read, its content does not fit, or two contradict each other.
    """
    given = [] if rig is None else [rig] if isinstance(rig, RigFile | str | PathLike) else [*rig]
    presets = {path.stem: path for path in sorted(bundled("rigs").glob("*.yaml"))}
    loaded = []
    for number, one in enumerate(given, 1):
        if isinstance(one, RigFile):
            loaded.append((f"rig {number}", one))
        else:
            path = preset_or_file(one, presets, "a rig file", CalibrationError)
            loaded.append((str(path), load_rig(path)))
    return merge_rigs(loaded) if loaded else None
