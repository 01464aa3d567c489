"""Arguments and options that several commands have in common."""

import inspect
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path, PurePath
from typing import Annotated, Literal, TypeVar

import typer

from lidcam.cli.printing.log import Verbosity, configure_logging
from lidcam.outputs.registry import endings_of
from lidcam.pipeline.core.errors import ConfigError

logger = logging.getLogger(__name__)

T = TypeVar("T", str, Path)

MAX_SECONDS = 1e9
"""Thirty years: longer than any recording, and well within 64 bits of nanoseconds."""


def seconds(value: float | None) -> float | None:
    """Refuse times that no recording has.

    Raises:
        typer.BadParameter: the value is too large or not a number.
    """
    if value is not None and not value <= MAX_SECONDS:
        raise typer.BadParameter(f"expected at most {MAX_SECONDS:.0f} seconds, found {value}")
    return value


def duration(value: float | None) -> float | None:
    """Refuse times that no recording lasts.

    Raises:
        typer.BadParameter: the value is 0, too large or not a number.
    """
    if value == 0:
        raise typer.BadParameter("expected more than 0 seconds")
    return seconds(value)


def named_as(option: str) -> Callable[[T | None], T | None]:
    """A check of the name of an output that an option of `lidcam process` asks for."""
    return ends_in(*endings_of(option))


def ends_in(*endings: str) -> Callable[[T | None], T | None]:
    """A check of an option: its file has a name with one of these endings; with "", a folder's name without ending."""

    def check(value: T | None) -> T | None:
        if value is not None and PurePath(value).suffix not in endings:
            what = f"ends in {' or '.join(endings)}" if any(endings) else "has no ending, for a folder"
            raise typer.BadParameter(f"expected a name that {what}, found {value}")
        return value

    return check


@contextmanager
def requirement_errors() -> Iterator[None]:
    """Turn requirements that cannot be read, or name no figure, into wrong usage.

    Raises:
        typer.BadParameter: there is one.
    """
    try:
        yield
    except ConfigError as err:
        from lidcam.evaluation.requirement import RequirementError  # mostly nothing is required

        if not isinstance(err, RequirementError):
            raise
        raise typer.BadParameter(str(err), param_hint="--require") from err


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # it takes a fifth of what --help does

        typer.echo(f"lidcam {version('lidcam')}")
        raise typer.Exit


def _scenarios(incomplete: str) -> list[str]:
    from lidcam.bags.simulator.scenario.load import scenario_names  # the shell asks; other commands do without

    return [name for name in scenario_names() if name.startswith(incomplete)]


Version = Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")]
ConfigFile = Annotated[
    str | None,  # a Path would turn ./road, a file, into road, a preset
    typer.Option(
        "--config",
        metavar="PRESET|FILE",
        help="Settings: sandbox, crossing, road, or a YAML file; without it, what suits the recording.",
    ),
]
Setting = Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="One setting; may be repeated.")]
RigFile = Annotated[
    list[str] | None,
    typer.Option(
        "--rig",
        metavar="FILE",
        help="Sensors, calibration and zones: a rig file, a preset (original), or a calibration file of KITTI, Kalibr, "
        "Autoware or the predecessor system. May be repeated: later files add and replace. Without it, as recorded.",
    ),
]
Model2d = Annotated[
    str | None,
    typer.Option(
        "--model-2d",
        metavar="FILE.onnx|NAME",
        help="2D network: an ONNX file, one that `lidcam fetch` brought, or `simulated`, for simulated images.",
    ),
]
Model3d = Annotated[
    Path | None,
    typer.Option(
        "--model-3d",
        metavar="FILE.onnx|NAME",
        help="3D network: an ONNX file, `traffic` (the default for road users of full size) or `sandbox`.",
    ),
]
Start = Annotated[float, typer.Option(min=0, metavar="S", callback=seconds, help="Skip the first S seconds.")]
Duration = Annotated[
    float | None,
    typer.Option(
        "--duration", min=0, metavar="S", callback=duration, help="Process S seconds; without it, to the end."
    ),
]
Every = Annotated[int | None, typer.Option("--every", min=1, metavar="N", help="Process every Nth frame only.")]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Processes that share the frames; without it, run.workers of the settings, else one per core. The "
        "output is the same.",
    ),
]
OnBad = Annotated[
    Literal["skip", "fail"],
    typer.Option(help="What to do about a message that cannot be decoded, or a damaged file."),
]
CopyTopics = Annotated[
    list[str] | None,
    typer.Option(
        "--copy-topics",
        metavar="PATTERN",
        help="Topics to copy to the output, as /map or '/ground_truth/*'; may be repeated. Without it, those of "
        "the truth.",
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Also replace what no earlier run of this command wrote, such as a recording; never an input.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON, in place of tables.")]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json-file", metavar="FILE.json", callback=ends_in(".json"), help="Write the result as JSON, too."),
]
Require = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        metavar='"FIGURE >= N"',
        help="Exit with 1 if a figure is not so; @FILE has one in a line. May be repeated.",
    ),
]
Scenario = Annotated[
    str,
    typer.Argument(metavar="SCENARIO", help="Name of a scenario, or a YAML file.", autocompletion=_scenarios),
]
RecordingOut = Annotated[Path, typer.Argument(metavar="OUT", help="OUT.bag, OUT.mcap, or a folder (sqlite3).")]
Format = Annotated[
    Literal["ros1", "sqlite3", "mcap"] | None,
    typer.Option("--format", help="Format of the recording; without it, the ending of its name decides."),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Log what is done to stderr, frame by frame.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Only errors and the result.")]
LogFile = Annotated[
    Path | None,
    # Lines are appended: to no recording by mistake.
    typer.Option(
        "--log-file", metavar="FILE", callback=ends_in(".log", ".txt"), help="Append the whole log, with times (UTC)."
    ),
]
Truth = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PATH",
        help="A recording with topics of truth, or labels; without it, what was copied into the result. May be "
        "repeated.",
    ),
]
Seed = Annotated[int | None, typer.Option(min=0, metavar="N", help="Seed of the noise, instead of the scenario's.")]


def _log_versions() -> None:
    from importlib.metadata import version
    from platform import platform, python_version

    logger.info("lidcam %s, Python %s, %s", version("lidcam"), python_version(), platform())


def with_log_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command that also takes --verbose, --quiet and --log-file, and configures logging before it begins."""

    @wraps(command)
    def configured(
        *args: object, verbose: bool = False, quiet: bool = False, log_file: Path | None = None, **kwargs: object
    ) -> None:
        if verbose and quiet:
            raise typer.BadParameter("expected one of --verbose and --quiet, found both", param_hint="--quiet")
        level = Verbosity.VERBOSE if verbose else Verbosity.QUIET if quiet else Verbosity.NORMAL
        configure_logging(level, log_file)
        if verbose or log_file is not None:
            _log_versions()
        command(*args, **kwargs)

    # Typer takes the options from these.
    options = {"verbose": (Verbose, False), "quiet": (Quiet, False), "log_file": (LogFile, None)}
    signature = inspect.signature(command)
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        for name, (annotation, default) in options.items()
    ]
    vars(configured)["__signature__"] = signature.replace(parameters=[*signature.parameters.values(), *added])
    configured.__annotations__ = {**command.__annotations__, **{name: kind for name, (kind, _) in options.items()}}
    return configured
