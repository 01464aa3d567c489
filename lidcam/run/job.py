"""A run as a value: everything it needs to know, nothing open. It can be pickled, and run in another process."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from os import PathLike, fspath
from pathlib import Path
from typing import TypedDict, get_args

from lidcam.pipeline.core.errors import CalibrationError, ConfigError, OutputError
from lidcam.pipeline.core.settings.bundled import bundled, preset_or_file
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import brief
from lidcam.readers.location import Location, RemotePath, location
from lidcam.readers.rig.merge import merge_rigs
from lidcam.readers.rig.rig_file import load_rig
from lidcam.readers.rig.schema import RigFile
from lidcam.readers.streams.decoders import OnBadMessage
from lidcam.run.choice import SettingsChoice, choose_settings
from lidcam.run.effect import named_files

DEFAULT_SETTINGS = SettingsChoice(Config())

FilePath = str | PathLike[str]
PathOrUrl = FilePath | RemotePath
Settings = Mapping[str, object] | Sequence[str]
RigSource = RigFile | FilePath | Sequence[RigFile | FilePath]
"""A rig file, loaded, by its path or by the name of a preset; or several, of which later ones add and replace."""


@dataclass(frozen=True, slots=True)
class Job:
    """One recording to process.

    Attributes:
        inputs: A recording, or all parts of a split one in order.
        outputs: Files to write, and a folder; what each is, its name says (`lidcam.outputs.registry.OUTPUTS`).
        settings: The settings, or those among which the recording decides.
        rig: Sensors and calibration, of all rig files together; what it leaves out, and all of it without one, is found
            in the recording.
        start_s: Seconds of the recording to skip.
        duration_s: Seconds to process; None: to the end.
        on_bad_message: Whether a message that cannot be decoded, or damage of a file, is skipped or ends the run.
        overwrite: Whether outputs replace files that are no results of earlier runs, too.
        read_files: Other files that are read: settings, rig files, a network. No output may replace them.
        view: Whether the Rerun viewer shows the frames while the run goes on.
        foxglove: Host and port at which they are served over Foxglove's protocol; None: they are not.
        pace: Times as fast as it was recorded that the run goes at most; None: as fast as it can.
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

    __repr__ = brief

    def __post_init__(self) -> None:
        """Check the part of the recording.

        Raises:
            ConfigError: it does not begin at 0 s or later, is empty, `on_bad_message` is neither `skip` nor `fail`, or
                `pace` is not positive.
        """
        if not 0 <= self.start_s < inf:
            raise ConfigError(f"start_s: expected 0 s or more, found {self.start_s}")
        if self.duration_s is not None and not 0 < self.duration_s < inf:
            raise ConfigError(f"duration_s: expected more than 0 s, found {self.duration_s}")
        if self.on_bad_message not in get_args(OnBadMessage):
            raise ConfigError(f"on_bad_message: expected skip or fail, found {self.on_bad_message!r}")
        if self.pace is not None and not 0 < self.pace < inf:
            raise ConfigError(f"pace: expected more than 0, found {self.pace}")

    @property
    def config(self) -> Config:
        """The settings; where the recording decides, those that it is opened with."""
        return self.settings.config


class JobOptions(TypedDict, total=False):
    """Options of a job, all with a default.

    Attributes:
        config: Settings, the name of a preset (`sandbox`, `crossing`, `road`), or a YAML file; without any, the preset
            that suits the recording is taken.
        settings: Single settings on top: `{"sync.slop_s": 0.05}` or `["sync.slop_s=0.05"]`.
        rig: Rig file, loaded, by its path or by the name of a preset; or several, of which later ones add to and
            replace what earlier ones say. Without it sensors and calibration are found in the recording.
        model_2d: 2D network: an ONNX file (docs/networks.md lists the exports that are known), or the name of one that
            `lidcam fetch` brought.
        model_3d: 3D network: an ONNX file (of `lidcam train pillars` or `convert`), `traffic` or `sandbox`.
        copy_topics: Topics that are copied to the MCAP output, by name or shell pattern; None: those of the truth.
        workers: Processes that share the frames, with this one; None: `run.workers` of the settings, else one per core.
            The result is the same.
        every: Of this many frames the first is processed; None: `sync.every` of the settings, all by default.
        start_s: Seconds to skip.
        duration_s: Seconds to process; None: to the end.
        on_bad_message: `skip` counts messages that cannot be decoded, `fail` ends the run at the first.
        overwrite: Outputs replace files that are no results of earlier runs, too; never an input.
        view: The Rerun viewer shows each frame when it is given.
        foxglove: Port, or `HOST:PORT`, at which each frame is served over Foxglove's protocol when it is given; without
            a host, to this machine alone.
        pace: Times as fast as it was recorded that the run goes at most; None: as fast as it can.
        save_matches: Folder to be written, with a picture of each camera and frame.
    """

    config: Config | FilePath | None
    settings: Settings
    rig: RigSource | None
    model_2d: FilePath | None
    model_3d: FilePath | None
    copy_topics: Sequence[str] | None
    workers: int | None
    every: int | None
    start_s: float
    duration_s: float | None
    on_bad_message: OnBadMessage
    overwrite: bool
    view: bool
    foxglove: int | str | None
    pace: float | None
    save_matches: FilePath | None


def make_job(
    recording: PathOrUrl | Sequence[PathOrUrl],
    output: FilePath | Sequence[FilePath] | None = None,
    *,
    config: Config | FilePath | None = None,
    settings: Settings = (),
    rig: RigSource | None = None,
    model_2d: FilePath | None = None,
    model_3d: FilePath | None = None,
    copy_topics: Sequence[str] | None = None,
    workers: int | None = None,
    every: int | None = None,
    start_s: float = 0.0,
    duration_s: float | None = None,
    on_bad_message: OnBadMessage = "skip",
    overwrite: bool = False,
    view: bool = False,
    foxglove: int | str | None = None,
    pace: float | None = None,
    save_matches: FilePath | None = None,
) -> Job:
    """A job, with its settings and its rig file read; arguments as of `lidcam.process`.

    Raises:
        ConfigError: the settings cannot be read or do not fit, or the part of the recording is not one.
        CalibrationError: the rig file cannot be read or does not fit.
        OutputError: an output is not a local file.
    """
    outputs = locations([] if output is None else output)
    if remote := [path for path in outputs if isinstance(path, RemotePath)]:
        raise OutputError(f"{remote[0]}: expected the name of a local file as output")
    folders = [] if save_matches is None else [Path(save_matches)]
    given = {
        "detect2d.model": model_2d,
        "detect3d.model": model_3d,
        "output.copy_topics": None if copy_topics is None else list(copy_topics),
        "run.workers": workers,
        "sync.every": every,
    }
    more = {key: value for key, value in given.items() if value is not None}
    choice = choose_settings(config, settings, more)
    return Job(
        inputs=locations(recording),
        outputs=(*(path for path in outputs if isinstance(path, Path)), *folders),
        settings=choice,
        rig=read_rig(rig),
        start_s=start_s,
        duration_s=duration_s,
        on_bad_message=on_bad_message,
        overwrite=overwrite,
        read_files=read_files(config, rig, *named_files(choice.config).values()),
        view=view,
        foxglove=None if foxglove is None else _served_address(str(foxglove)),
        pace=pace,
    )


def _served_address(text: str) -> tuple[str, int]:
    """Host and port of `8765`, `0.0.0.0:8765` or `[::1]:8765`; without a host that of this machine alone.

    Raises:
        ConfigError: it is none of these.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) < 1 << 16):
        raise ConfigError(f"foxglove: expected PORT or HOST:PORT, found {text!r}")
    return host.removeprefix("[").removesuffix("]") or "127.0.0.1", int(port)


def locations(recording: PathOrUrl | Sequence[PathOrUrl]) -> tuple[Location, ...]:
    """Where the files of a recording lie.

    Raises:
        RecordingError: a name is empty.
    """
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
