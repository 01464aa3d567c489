"""Arguments of the commands of `lidcam config`."""

from typing import Annotated

import typer

from lidcam.options import AsJson, with_log_options

__all__ = ["config_app"]

# \b keeps the lines of a paragraph as they are.
CONFIG_EXAMPLES = """\b
Examples:
  lidcam config list
  lidcam config show sandbox
  lidcam config show road > mine.yaml
  lidcam config explain detect3d.cluster.distance_m
  lidcam config explain combine
"""


config_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, epilog=CONFIG_EXAMPLES
)


@config_app.command("list")
@with_log_options
def config_list(as_json: AsJson = False) -> None:
    """List the presets."""
    from lidcam.commands.config import run_list

    run_list(as_json=as_json)


@config_app.command("show")
@with_log_options
def config_show(
    name: Annotated[str, typer.Argument(metavar="PRESET|FILE", help="sandbox, crossing, road, or a YAML file.")],
    changes: Annotated[bool, typer.Option("--changes", help="Only what differs from the defaults.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print all settings of a preset or a file, as YAML to copy."""
    from lidcam.commands.config import run_show

    run_show(name, changes=changes, as_json=as_json)


@config_app.command("explain")
@with_log_options
def config_explain(
    key: Annotated[str, typer.Argument(metavar="KEY", help="A setting or a section; without it, the sections.")] = "",
    as_json: AsJson = False,
) -> None:
    """Explain a setting.

    Its meaning, unit, allowed values, default, and its value in each preset.
    """
    from lidcam.commands.config import run_explain

    run_explain(key, as_json=as_json)
