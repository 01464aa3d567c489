"""The JSON of a command: one document with the figures, printed in place of the tables, written to a file, or both."""

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
"""Rises when a key gets another meaning or is taken away, not when one is added."""


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
    """The result of a command as one JSON document.

    Args:
        command: Its name.
        inputs: The files that it read, in the order in which they were named.
        settings: At least their `name` and their `sha256`.
        figures: Its figures, under keys of their own.
        verdict: How it ends.
        truth: Where the truth comes from; None without truth.
        warnings: Why the figures may be doubtful.
        notes: Remarks.
    """
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
    """A function that writes a document to the file; the file has its name when the block ends.

    Args:
        file: Where it is written; None: nowhere.
        inputs: Files and folders that are read, and other outputs: none may be the file.
        overwrite: Replace also what no earlier run wrote.

    Raises:
        OutputError: the file cannot be written, or must not be replaced.
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
