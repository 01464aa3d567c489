"""The JSON of a command: one document with the figures, printed instead of the tables, or written to a file."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lidcam.cli.printing.escaping import json_text
from lidcam.cli.printing.log import remark_log
from lidcam.cli.verdict import Verdict
from lidcam.outputs.allowed import TEXT, check_no_input, check_replaced
from lidcam.readers.input_file import InputFile
from lidcam.readers.location import Location
from lidcam.run.warning import RunWarning
from lidcam.writers.outputs.marks import marked_json
from lidcam.writers.outputs.transaction import OutputTransaction

SCHEMA_NAME = "lidcam.figures"
"""docs/figures.schema.json describes it."""

SCHEMA_VERSION = 1
"""Incremented when a key changes its meaning or is removed, not when one is added."""


def figures_document(
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
    """The result of a command as one JSON document; `settings` has at least their `name` and `sha256`."""
    return {
        "schema": {"name": SCHEMA_NAME, "version": SCHEMA_VERSION},
        "lidcam_version": version("lidcam"),
        "command": command,
        "inputs": [file.tree() for file in inputs],
        "settings": dict(settings),
        "truth": None if truth is None else dict(truth),
        **figures,
        "warnings": [asdict(warning) for warning in warnings],
        "notes": list(notes),
        **verdict.tree(),
    }


@contextmanager
def json_output(
    file: Path | None, *, inputs: Iterable[Location], overwrite: bool
) -> Generator[Callable[[Any], None], None, None]:
    """A function that writes a document to the file, if any, which gets its name when the block ends.

    Raises:
        OutputError: the file cannot be written, is an input or another output, or must not be replaced.
    """
    if file is None:
        yield lambda _: None
        return
    check_no_input([file], inputs)
    with OutputTransaction([file], check_old=check_replaced(lambda _: TEXT, overwrite=overwrite)) as outputs:

        def write(tree: Any) -> None:
            outputs[file].write_text(marked_json(f"{json_text(tree)}\n"))

        yield write
    remark_log.info("wrote %s", file)
