"""Wraps text to the terminal width.

In pipes and files a row of a table and a remark are one line each, so that `grep` finds whole names. On a terminal
names and sentences are folded to its width; numbers never are.
"""

import re
from collections.abc import Iterator

from rich.cells import cell_len, chop_cells
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from lidcam.cli.printing.escaping import visible

MAX_COLUMNS = 10_000
"""Width for a table that is not folded."""

MIN_FOLDED = 8
"""Minimum width of a folded text."""

INDENT = "  "
"""Indent of the lines after the first."""

_PIECES = re.compile(r"/?[^/_.,:;-]+[/_.,:;-]*|[/_.,:;-]+")


class Folded:
    """A text that is folded to the available width, after a blank if it has one, else after a mark."""

    def __init__(self, text: str, style: str = "") -> None:
        self.text, self.style = visible(text), style

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        length = cell_len(self.text)
        return Measurement(min(length, MIN_FOLDED), length).with_maximum(options.max_width)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for line in folded_lines(self.text, options.max_width):
            yield Text(line.strip() if options.justify == "right" else line, self.style)


def folded_lines(text: str, width: int) -> Iterator[str]:
    """Lines of at most `width` columns that join to the text, except for blanks at their ends."""
    line = ""
    for position, word in enumerate(text.split(" ")):
        parts = [word] if cell_len(word) <= width - len(INDENT) else _PIECES.findall(word)
        blank = " " if position else ""
        for part in parts:
            if line.strip() and cell_len(line) + len(blank) + cell_len(part) > width:
                yield line
                line = INDENT
                blank = ""
            line += blank + part
            blank = ""
            while cell_len(line) > width:  # a part without a mark
                first = chop_cells(line, width)[0]
                yield first
                line = INDENT + line[len(first) :]
    yield line


def show_table(out: Console, table: Table) -> None:
    """Print a table, folded on a terminal; without trailing blanks."""
    if table.title:
        show_line(out, str(table.title), "bold")
        table.title = None  # rich would fold it to the width of the table
    needed = Measurement.get(out, out.options.update(width=MAX_COLUMNS), table)
    width = max(out.width, needed.minimum) if out.is_terminal else needed.maximum
    for line in out.render_lines(table, out.options.update(width=width), pad=False):
        text = Text.assemble(*((segment.text, segment.style or "") for segment in line))
        text.rstrip()
        out.print(text, soft_wrap=not out.is_terminal)


def show_line(out: Console, text: str, style: str = "") -> None:
    """Print a line, folded on a terminal."""
    text = visible(text)
    for line in folded_lines(text, out.width) if out.is_terminal else (text,):
        out.print(Text(line, style))
