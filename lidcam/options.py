"""Arguments and options that several commands have in common."""

import inspect
import logging
from collections.abc import Callable
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from lidcam.printing.log import Verbosity, configure_logging

__all__ = [
    "STDOUT",
    "AllowedDifference",
    "AsJson",
    "CompareConfigFile",
    "ConfigFile",
    "EvaluateConfigFile",
    "EvaluateRigFile",
    "Format",
    "JsonCommand",
    "JsonTarget",
    "Overwrite",
    "RecordingOut",
    "Require",
    "RigFile",
    "Scenario",
    "Seed",
    "Setting",
    "Version",
    "seconds",
    "with_log_options",
]

logger = logging.getLogger(__name__)


LOG_SUFFIXES = (".log", ".txt")
"""Endings of the name of a log file."""

MAX_SECONDS = 1e9
"""Thirty years: longer than any recording, and well within 64 bits of nanoseconds."""


class AllowedDifference(StrEnum):
    """What two results may differ in: the kinds of `pipeline.evaluation.comparison.objects`, and frames."""

    LOST = "lost"
    NEW = "new"
    MOVED = "moved"
    TURNED = "turned"
    RESIZED = "resized"
    RELABELLED = "relabelled"
    RESCORED = "rescored"
    REIDENTIFIED = "reidentified"
    FRAMES = "frames"


def seconds(value: float | None) -> float | None:
    """Refuse times that no recording has.

    Raises:
        typer.BadParameter: the value is too large or not a number.
    """
    if value is not None and not value <= MAX_SECONDS:
        raise typer.BadParameter(f"expected at most {MAX_SECONDS:.0f} seconds, found {value}")
    return value


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # it takes a fifth of what --help does

        typer.echo(f"lidcam {version('lidcam')}")
        raise typer.Exit


def _log_file(value: Path | None) -> Path | None:
    if value is not None and value.suffix not in LOG_SUFFIXES:  # lines are appended: to no recording by mistake
        raise typer.BadParameter(f"expected a name that ends in {' or '.join(LOG_SUFFIXES)}, found {value}")
    return value


STDOUT = "-"
JSON_SUFFIX = ".json"


class JsonCommand(TyperCommand):
    """A command whose --json may be followed by the name of a file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments; --json without a file means standard output."""
        return super().parse_args(ctx, _with_json_target(args))


def _with_json_target(args: list[str]) -> list[str]:
    """The arguments, with `-` behind each --json that names no file: click knows no options whose value may be missing.

    Only a name that ends in .json is one: what follows may as well be an argument.
    """
    end = args.index("--") if "--" in args else len(args)
    options = []
    for arg, after in zip(args[:end], [*args[1:end], ""], strict=False):
        options.append(arg)
        if arg == "--json" and after != STDOUT and not after.endswith(JSON_SUFFIX):
            options.append(STDOUT)
    return options + args[end:]


def _json_target(value: str | None) -> str | None:
    if value not in (None, STDOUT) and not str(value).endswith(JSON_SUFFIX):
        raise typer.BadParameter(f"expected a name that ends in {JSON_SUFFIX}, found {value}")
    return value


def _scenarios(incomplete: str) -> list[str]:
    from bags.simulator.scenario.load import scenario_names  # the shell asks; other commands do without

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
CompareConfigFile = Annotated[
    str | None,
    typer.Option("--config", metavar="PRESET|FILE", help="Settings, of which `compare` counts: the tolerances."),
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
EvaluateRigFile = Annotated[
    list[str] | None,
    typer.Option(
        "--rig",
        metavar="FILE",
        help="A rig file, of which the zones and the vehicles of the truth count; sensors are those of the result. May "
        "be repeated.",
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Also replace what no earlier run of this command wrote, such as a recording; never an input.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
JsonTarget = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="[FILE.json]",
        callback=_json_target,
        help="Print the result as JSON; with a file, write it there beside the tables.",
    ),
]
Require = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        metavar='"FIGURE >= N"',
        help="Exit with 1 if a figure is not so; @FILE has one in a line. May be repeated.",
    ),
]
EvaluateConfigFile = Annotated[
    str | None,
    typer.Option("--config", metavar="FILE", help="Take the section evaluate of these settings, not the result's."),
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
    typer.Option("--log-file", metavar="FILE", callback=_log_file, help="Append the whole log, with times (UTC)."),
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
