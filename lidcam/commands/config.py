"""The work of `lidcam config`: the presets, and explanations of settings."""

import json
from dataclasses import asdict

from rich.text import Text

from lidcam.printing.escaping import visible_lines
from lidcam.printing.settings import print_explanation, print_presets
from lidcam.printing.terminal import console, show_json
from lidcam.settings.explain import explain, preset_summaries
from pipeline.core.settings.bundled import settings_file
from pipeline.core.settings.load import dump_config, load_config

__all__ = ["run_explain", "run_list", "run_show"]


def run_list(*, as_json: bool) -> None:
    """Print the presets."""
    if as_json:
        show_json(console(), dict(preset_summaries()))
    else:
        print_presets(console(), preset_summaries())


def run_show(name: str, *, changes: bool, as_json: bool) -> None:
    """Print all settings of a preset or file as YAML; `changes`: its file as it is, which has only what differs.

    Raises:
        ConfigError: there is no such preset or file, or its settings are wrong.
    """
    config = load_config(name)
    if as_json:
        show_json(console(), json.loads(config.model_dump_json()))
        return
    text = settings_file(name).read_text(encoding="utf-8") if changes else dump_config(config)
    console().print(Text(visible_lines(text.replace("\r\n", "\n"))), end="", soft_wrap=True)


def run_explain(key: str, *, as_json: bool) -> None:
    """Print what a key means.

    Raises:
        ConfigError: there is no such key.
    """
    explanation = explain(key)
    if as_json:
        show_json(console(), asdict(explanation))
    else:
        print_explanation(console(), explanation)
