"""Arguments and options that several commands have in common."""

import inspect
import logging
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from pathlib import Path, PurePath
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup

from lidcam.cli.printing.log import Verbosity, configure_logging
from lidcam.pipeline.core.errors import ConfigError
from lidcam.run.options import OPTION_DOCS, JobOptions

OTHERS = "Options"
"""Heading of the options that belong to no group."""


class Program(TyperGroup):
    """The commands of lidcam; a recording in place of a command is processed."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command of a name; `lidcam drive.bag` is `lidcam process drive.bag`."""
        word = args[0]
        if word not in self.commands and (set("./\\") & set(word) or Path(word).exists()):
            args = ["process", *args]
        return super().resolve_command(ctx, args)


class GroupedCommand(TyperCommand):
    r"""A command whose help lists its options by group, in the order in which the groups first occur.

    In the examples below the options, `\b` keeps the lines of a paragraph as they are.
    """

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The parts of the usage line; arguments as they are called, without braces."""
        return [re.sub(r"^\{(.*)\}(\.\.\.)?$", r"\1", piece) for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, then each group of options."""
        groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            if parameter.param_type_name == "argument":
                name, text = record
                groups["Arguments"].append((name.partition(" <")[0], text))
            else:
                groups[getattr(parameter, "rich_help_panel", None) or OTHERS].append(record)
        for group in sorted(groups, key=lambda name: name == OTHERS):
            with formatter.section(group):
                formatter.write_dl(groups[group], col_max=min(30, formatter.width // 2 - 8))


logger = logging.getLogger(__name__)

T = TypeVar("T", str, Path)

OUTPUTS, CHECKING, SCREEN = "Outputs", "Checks", "Screen and log"
"""Headings of options in the help, beside those of `JobOptions`."""

MAX_SECONDS = 1e9
"""Largest time of a recording that is accepted, seconds; well within 64 bits of nanoseconds."""


def seconds(value: float | None) -> float | None:
    """Refuse times that are too large or not a number."""
    if value is not None and not value <= MAX_SECONDS:
        raise typer.BadParameter(f"expected at most {MAX_SECONDS:.0f} seconds, found {value}")
    return value


def duration(value: float | None) -> float | None:
    """Refuse durations that are not positive, too large or not a number."""
    if value is not None and value <= 0:
        raise typer.BadParameter(f"expected more than 0 seconds, found {value:g}")
    return seconds(value)


def ends_in(*endings: str) -> Callable[[T | None], T | None]:
    """A check of an option: its file has a name with one of these endings; with "", a folder's name without ending."""

    def check(value: T | None) -> T | None:
        if value is not None and PurePath(value).suffix not in endings:
            what = f"ends in {' or '.join(endings)}" if any(endings) else "has no ending, for a folder"
            raise typer.BadParameter(f"expected a name that {what}, found {value}")
        return value

    return check


def option(text: str, *names: str, group: str | None = None, **more: Any) -> Any:
    """An option with its help, which is listed under the heading `group`; it is called as its parameter, or so."""
    return typer.Option(*names, help=text, rich_help_panel=group, **more)


def output_option(text: str, *endings: str, name: str = "OUT") -> Any:
    """An option that names an output with one of these endings."""
    return option(text, metavar="|".join(f"{name}{one}" for one in endings), callback=ends_in(*endings), group=OUTPUTS)


@contextmanager
def requirement_errors() -> Iterator[None]:
    """Turn requirements that cannot be parsed, or name an unknown figure, into wrong usage."""
    try:
        yield
    except ConfigError as err:
        from lidcam.evaluation.requirement import RequirementError  # mostly nothing is required

        if not isinstance(err, RequirementError):
            raise
        raise typer.BadParameter(str(err), param_hint="--require") from err


CHECKS: dict[str, Callable[[Any], Any]] = {"start_s": seconds, "duration_s": duration, "save_matches": ends_in("")}
"""Checks of the values of options of a job."""


def job_option(name: str) -> Any:
    """The command-line option of a keyword of `JobOptions`."""
    cli = JobOptions.__annotations__[name].__metadata__[0]
    text = OPTION_DOCS[name] + " May be repeated." * (cli.type == list[str])
    return option(text, cli.name, metavar=cli.metavar, min=cli.minimum, callback=CHECKS.get(name), group=cli.group)


def with_job_options(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator for commands that take `**options` of a job: the command line gets the named ones.

    The command gets those that are given. In the help they follow the required parameters.
    """
    options: dict[str, tuple[Any, Any]] = {}
    for name in names:
        kind = JobOptions.__annotations__[name].__metadata__[0].type
        is_switch = kind is bool
        options[name] = (Annotated[kind if is_switch else kind | None, job_option(name)], False if is_switch else None)

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def called(*args: object, **kwargs: object) -> None:
            command(*args, **{key: value for key, value in kwargs.items() if key not in options or value is not None})

        return _with_parameters(called, command, options, first=True)

    return decorated


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
            from importlib.metadata import version  # it takes a fifth of what --help does
            from platform import platform, python_version

            logger.info("lidcam %s, Python %s, %s", version("lidcam"), python_version(), platform())
        command(*args, **kwargs)

    options = {"verbose": (Verbose, False), "quiet": (Quiet, False), "log_file": (LogFile, None)}
    return _with_parameters(configured, command, options)


def _with_parameters(
    wrapper: Callable[..., None],
    command: Callable[..., None],
    options: Mapping[str, tuple[Any, Any]],
    *,
    first: bool = False,
) -> Callable[..., None]:
    """The wrapper with the signature of a command and these options, as (annotation, default), first or last."""
    own = [
        parameter
        for parameter in inspect.signature(command).parameters.values()
        if parameter.kind != inspect.Parameter.VAR_KEYWORD
    ]
    added = [
        inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=annotation)
        for name, (annotation, default) in options.items()
    ]
    at = sum(parameter.default is inspect.Parameter.empty for parameter in own) if first else len(own)
    parameters = [*own[:at], *added, *own[at:]]
    vars(wrapper)["__signature__"] = inspect.Signature(parameters)
    wrapper.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters} | {"return": None}
    return wrapper


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"lidcam {version('lidcam')}")
        raise typer.Exit


def _scenarios(incomplete: str) -> list[str]:
    from lidcam.bags.simulator.scenario.scenario import scenario_names  # the shell asks; other commands do without

    return [name for name in scenario_names() if name.startswith(incomplete)]


Version = Annotated[bool, option("Print the version.", "--version", callback=_version, is_eager=True)]
Setting = Annotated[list[str] | None, job_option("settings")]
Overwrite = Annotated[bool, job_option("overwrite")]
AsJson = Annotated[bool, option("Print the result as JSON instead of tables.", "--json", group=SCREEN)]
JsonFile = Annotated[Path | None, output_option("Also write the result as JSON.", ".json", name="FILE")]
Require = Annotated[
    list[str] | None,
    option(
        "Exit with code 1 if a requirement is not met; @FILE lists one per line. May be repeated.",
        "--require",
        metavar='"FIGURE >= N"',
        group=CHECKING,
    ),
]
Scenario = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="Name of a scenario, or a YAML file.", autocompletion=_scenarios)
]
RecordingOut = Annotated[Path, typer.Argument(metavar="OUT", help="OUT.bag (ROS 1) or OUT.mcap (ROS 2).")]
Verbose = Annotated[bool, option("Print all tables, and log every frame to stderr.", "--verbose", "-v", group=SCREEN)]
Quiet = Annotated[bool, option("Print only errors and the result.", "--quiet", "-q", group=SCREEN)]
LogFile = Annotated[
    Path | None,
    # Lines are appended: to no recording by mistake.
    option(
        "Append the full log, with UTC times.",
        "--log-file",
        metavar="FILE",
        callback=ends_in(".log", ".txt"),
        group=SCREEN,
    ),
]
Truth = Annotated[
    list[str] | None,
    option(
        "Ground truth: a recording with truth topics, or labels. Default: the topics copied into the result. May "
        "be repeated.",
        metavar="PATH",
    ),
]
Seed = Annotated[int | None, option("Seed of the noise. Default: the scenario's.", metavar="N", min=0)]
