"""The envelope of the figures that a command prints as JSON: inputs, settings, truth, and how the command ended."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from lidcam.checks.warning import RunWarning
from lidcam.commands.verdict import Verdict
from readers.input_file import InputFile

__all__ = ["SCHEMA_NAME", "SCHEMA_VERSION", "envelope"]

SCHEMA_NAME = "lidcam.figures"
"""docs/figures.schema.json describes it."""

SCHEMA_VERSION = 1
"""Rises when a key gets another meaning or is taken away, not when one is added."""


def envelope(
    command: str,
    *,
    inputs: Sequence[InputFile],
    settings: Mapping[str, Any],
    figures: Mapping[str, Any],
    verdict: Verdict,
    truth: Mapping[str, Any] | None = None,
    warnings: Sequence[RunWarning] = (),
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """The result of a command as one JSON document.

    Args:
        command: Its name.
        inputs: What it read, in the order in which it was named.
        settings: At least their `name` and their `sha256`.
        figures: What it found, under keys of its own.
        verdict: How it ends.
        truth: What the figures compare with; None if there is none.
        warnings: What makes the figures doubtful.
        notes: Remarks.

    Raises:
        ValueError: a key of the figures is one of the envelope's.
    """
    head = {
        "schema": {"name": SCHEMA_NAME, "version": SCHEMA_VERSION},
        "lidcam_version": version("lidcam"),
        "command": command,
        "inputs": [file.tree() for file in inputs],
        "settings": dict(settings),
        "truth": None if truth is None else dict(truth),
    }
    tail = {"warnings": [asdict(warning) for warning in warnings], "notes": list(notes), **verdict.tree()}
    if taken := sorted(figures.keys() & (head.keys() | tail.keys())):
        raise ValueError(f"figures: expected keys other than those of the envelope, found {', '.join(taken)}")
    return {**head, **figures, **tail}
