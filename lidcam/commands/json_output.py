"""The JSON of a command: printed in place of the tables, written to a file, or both."""

from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from lidcam.outputs.allowed import TEXT, check_no_input, check_replaced
from lidcam.printing.escaping import json_text
from lidcam.printing.log import remark_log
from lidcam.printing.terminal import show_json
from readers.location import Location
from writers.outputs.errors import output_errors
from writers.outputs.marks import marked_json
from writers.outputs.transaction import OutputTransaction

__all__ = ["JsonOutput", "json_output"]


@dataclass(slots=True)
class JsonOutput:
    """Where the JSON goes.

    Attributes:
        is_printed: Whether it is printed, and tables are not.
        tree: What it says; set by the command.
    """

    is_printed: bool
    tree: Any = None

    def show(self, out: Console, print_tables: Callable[[], None]) -> None:
        """Print the JSON, or else the tables."""
        if self.is_printed:
            show_json(out, self.tree)
        else:
            print_tables()


@contextmanager
def json_output(
    file: Path | None, *, is_printed: bool, inputs: Iterable[Location], overwrite: bool
) -> Generator[JsonOutput, None, None]:
    """Write the file, if there is to be one, when the block has set the tree and ended.

    Args:
        file: Where it is written; None: nowhere.
        is_printed: Print it in place of the tables.
        inputs: Files and folders that are read, and other outputs: none may be the file.
        overwrite: Replace what no earlier run wrote, too.

    Raises:
        OutputError: the file cannot be written, or must not be replaced.
    """
    output = JsonOutput(is_printed)
    if file is None:
        yield output
        return
    check_no_input([file], inputs)
    with OutputTransaction([file], check_old=check_replaced(lambda _: TEXT, overwrite=overwrite)) as outputs:
        yield output
        with output_errors(file):
            outputs[file].part.write_text(marked_json(f"{json_text(output.tree)}\n"), encoding="utf-8")
    remark_log.info("wrote %s", file)
