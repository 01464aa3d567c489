"""The commands `lidcam config list`, `show` and `explain`."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

import typer

from lidcam.cli.options import AsJson, GroupedCommand, option, with_log_options
from lidcam.cli.printing.escaping import visible_lines

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


@config_app.command("list", cls=GroupedCommand)
@with_log_options
def config_list(as_json: AsJson = False) -> None:
    """List the presets."""
    from lidcam.cli.printing.terminal import console, show_json, show_line
    from lidcam.run.explain import preset_summaries

    if as_json:
        show_json(console(), dict(preset_summaries()))
        return
    _show_pairs("presets", preset_summaries())
    show_line(console(), "Default: chosen from the recording; the first line of a run names the preset.")


@config_app.command("show", cls=GroupedCommand)
@with_log_options
def config_show(
    name: Annotated[str, typer.Argument(metavar="PRESET|FILE", help="sandbox, crossing, road, or a YAML file.")],
    changes: Annotated[bool, option("Only differences from the defaults.", "--changes")] = False,
    as_json: AsJson = False,
) -> None:
    """Print all settings of a preset or a file, as YAML to copy."""
    from rich.text import Text

    from lidcam.cli.printing.terminal import console, show_json
    from lidcam.pipeline.core.settings.bundled import settings_file
    from lidcam.pipeline.core.settings.load import dump_config, load_config

    config = load_config(name)
    if as_json:
        show_json(console(), json.loads(config.model_dump_json(exclude_unset=changes)))
        return
    text = settings_file(name).read_text(encoding="utf-8") if changes else dump_config(config)
    console().print(Text(visible_lines(text.replace("\r\n", "\n"))), end="", soft_wrap=True)


@config_app.command("explain", cls=GroupedCommand)
@with_log_options
def config_explain(
    key: Annotated[str, typer.Argument(metavar="KEY", help="A setting or a section. Default: list the sections.")] = "",
    as_json: AsJson = False,
) -> None:
    """Explain a setting.

    Meaning, unit, allowed values, default, and its value in each preset.
    """
    from lidcam.cli.printing.terminal import console, show_json, show_line
    from lidcam.run.explain import explain

    explanation, out = explain(key), console()
    if as_json:
        show_json(out, asdict(explanation))
        return
    show_line(out, explanation.key or "settings", "bold")
    show_line(out, explanation.meaning)
    out.print()
    facts = {"unit": explanation.unit, "allowed": explanation.allowed}
    if not explanation.keys and explanation.by_preset:
        facts |= {"default": _text(explanation.default)}
        facts |= {name: _text(value) for name, value in explanation.by_preset.items()}
    _show_pairs("", {name: text for name, text in facts.items() if text})
    _show_pairs("keys", explanation.keys)


def _show_pairs(title: str, pairs: Mapping[str, str]) -> None:
    """A table of names and texts, if there are any."""
    from lidcam.cli.printing.tables import pairs_table
    from lidcam.cli.printing.terminal import console, show_table

    if pairs:
        show_table(console(), pairs_table(title, pairs))


def _text(value: Any) -> str:
    from lidcam.pipeline.core.settings.validation import found

    return found(value) if isinstance(value, str | int | float | list | None) else json.dumps(value)
