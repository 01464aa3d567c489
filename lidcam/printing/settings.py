"""Printing of `lidcam config`."""

import json
from collections.abc import Mapping
from typing import Any

from rich.console import Console

from lidcam.printing.folding import show_line, show_table
from lidcam.printing.tables import pairs_table
from lidcam.settings.explain import Explanation
from pipeline.core.settings.validation import found

__all__ = ["print_explanation", "print_presets"]


def print_presets(out: Console, summaries: Mapping[str, str]) -> None:
    """The presets with what they are for."""
    show_table(out, pairs_table("presets", summaries))
    show_line(out, "Without --config the recording decides: see the line `settings` of its final table.")


def print_explanation(out: Console, explanation: Explanation) -> None:
    """Print the values of a key, or the keys in it."""
    show_line(out, explanation.key or "settings", "bold")
    show_line(out, explanation.meaning)
    out.print()
    facts = {"unit": explanation.unit, "allowed": explanation.allowed}
    if not explanation.keys and explanation.by_preset:
        facts |= {"default": _text(explanation.default)}
        facts |= {name: _text(value) for name, value in explanation.by_preset.items()}
    if known := {name: text for name, text in facts.items() if text}:
        show_table(out, pairs_table("", known))
    if explanation.keys:
        show_table(out, pairs_table("keys", explanation.keys))


def _text(value: Any) -> str:
    return found(value) if isinstance(value, str | int | float | list | None) else json.dumps(value)
