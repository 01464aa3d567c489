"""A run as a value: everything it needs to know, nothing open. It can be pickled, and run in another process."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TypedDict, Unpack

from pydantic import ValidationError

from pipeline.core.errors import ConfigError
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import describe_validation, load_config, set_values
from readers.location import Location, RemotePath, location
from readers.rig.rig_file import load_rig
from readers.rig.schema import RigFile
from readers.streams.decoders import OnBadMessage

__all__ = ["FilePath", "Job", "JobOptions", "PathOrUrl", "Settings", "locations", "make_job", "read_config", "read_rig"]

DEFAULT_CONFIG = Config()
FilePath = str | PathLike[str]
PathOrUrl = FilePath | RemotePath
Settings = Mapping[str, object] | Sequence[str]


@dataclass(frozen=True, slots=True)
class Job:
    """One recording to process.

    Attributes:
        inputs: A recording, or all parts of a split one in order.
        outputs: Files to write; what each is, its name says (`lidcam.outputs.WRITERS`).
        config: Settings.
        rig: Sensors and calibration; what it leaves out, and all of it without one, is found in the recording.
        start_s: Seconds of the recording to skip.
        duration_s: Seconds to process; None: to the end.
        on_bad_message: Whether a message that cannot be decoded, or damage of a file, is skipped or ends the run.
    """

    inputs: tuple[Location, ...]
    outputs: tuple[Path, ...] = ()
    config: Config = DEFAULT_CONFIG
    rig: RigFile | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    on_bad_message: OnBadMessage = "skip"


class JobOptions(TypedDict, total=False):
    """Options of a job, all with a default.

    Attributes:
        config: Settings, or a YAML file of them.
        settings: Single settings on top: `{"sync.slop_s": 0.05}` or `["sync.slop_s=0.05"]`.
        rig: Rig file, loaded or by its path; without it sensors and calibration are found in the recording.
        model_2d: 2D network (ONNX, YOLOX layout).
        workers: 1 runs stage after stage; more overlap stages of several frames. The result is the same.
        start_s: Seconds to skip.
        duration_s: Seconds to process; None: to the end.
        on_bad_message: `skip` counts messages that cannot be decoded, `fail` ends the run at the first.
    """

    config: Config | FilePath | None
    settings: Settings
    rig: RigFile | FilePath | None
    model_2d: FilePath | None
    workers: int | None
    start_s: float
    duration_s: float | None
    on_bad_message: OnBadMessage


def make_job(
    recording: PathOrUrl | Sequence[PathOrUrl],
    output: FilePath | Sequence[FilePath] | None = None,
    **options: Unpack[JobOptions],
) -> Job:
    """A job, with its settings and its rig file read; arguments as of `lidcam.process`.

    Raises:
        ConfigError: the settings cannot be read or do not fit.
        CalibrationError: the rig file cannot be read or does not fit.
    """
    outputs = [] if output is None else [output] if isinstance(output, str | PathLike) else output
    overrides = list(_overrides(options.get("settings", ())))
    if (model_2d := options.get("model_2d")) is not None:
        overrides.append(f"detect2d.model={json.dumps(fspath(model_2d))}")
    if (workers := options.get("workers")) is not None:
        overrides.append(f"run.workers={workers}")
    return Job(
        inputs=locations(recording),
        outputs=tuple(map(Path, outputs)),
        config=read_config(options.get("config"), overrides),
        rig=read_rig(options.get("rig")),
        start_s=options.get("start_s", 0.0),
        duration_s=options.get("duration_s"),
        on_bad_message=options.get("on_bad_message", "skip"),
    )


def locations(recording: PathOrUrl | Sequence[PathOrUrl]) -> tuple[Location, ...]:
    """Where the files of a recording lie."""
    given = [recording] if isinstance(recording, str | PathLike | RemotePath) else recording
    return tuple(one if isinstance(one, RemotePath) else location(fspath(one)) for one in given)


def read_config(config: Config | FilePath | None = None, settings: Settings = ()) -> Config:
    """Settings, given or from a YAML file, with single values on top.

    Raises:
        ConfigError: the file cannot be read, a key is unknown, or a value does not fit.
    """
    overrides = _overrides(settings)
    if not isinstance(config, Config):
        return load_config(None if config is None else Path(config), overrides)
    tree = config.model_dump(mode="json")
    set_values(tree, overrides)
    try:
        return Config.model_validate(tree)
    except ValidationError as err:
        raise ConfigError(f"settings: {describe_validation(Config, err)}") from err


def read_rig(rig: RigFile | FilePath | None) -> RigFile | None:
    """A rig file, loaded or by its path.

    Raises:
        CalibrationError: it cannot be read, or its content does not fit.
    """
    return rig if rig is None or isinstance(rig, RigFile) else load_rig(Path(rig))


def _overrides(settings: Settings) -> tuple[str, ...]:
    """Single settings in the form `a.b=value`."""
    if isinstance(settings, Mapping):
        return tuple(f"{key}={json.dumps(value)}" for key, value in settings.items())
    return tuple(settings)
