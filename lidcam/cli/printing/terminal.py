"""A console that prints text as it is, with control characters made visible, and wraps it to the terminal's width.

In pipes and files a row of a table and a remark are one line each, so that `grep` finds whole names. On a terminal
names and sentences are folded to its width; numbers never are.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator
from io import StringIO
from typing import Any, Literal

from rich.cells import cell_len, chop_cells
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.highlighter import JSONHighlighter
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from lidcam.cli.printing.escaping import json_text, printable_lines, visible

HTML_WIDTH = 300
"""Characters of a line: a page can be scrolled."""


class _Console(Console):
    """A console with control characters made visible; `lidcam ... | head` ends the listing, not the work."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Escape every text before its width is measured."""
        return super().render_str(visible(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Escape all other output, except styles and cursor movements."""
        for segment in super().render(renderable, options):
            is_text = segment.control is None and not segment.text.isprintable()
            yield Segment(printable_lines(segment.text), segment.style) if is_text else segment

    def on_broken_pipe(self) -> None:
        self.quiet = True
        # Buffered text goes nowhere, and neither does text that is printed by other means.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.file.fileno())
        os.close(nowhere)


def console(*, stderr: bool = False) -> Console:
    """A console without markup, which names of topics may look like, and without wrapping; plain with NO_COLOR."""
    colors: Literal["auto"] | None = None if os.environ.get("NO_COLOR") else "auto"
    return _Console(stderr=stderr, soft_wrap=True, markup=False, emoji=False, color_system=colors)


def printed_text(show: Callable[[Console], None]) -> str:
    """The output of a function that prints on a console, as text of a wide one."""
    out = _recording_console()
    show(out)
    return "\n".join(line.rstrip() for line in out.export_text().strip("\n").splitlines())


def printed_html(show: Callable[[Console], None]) -> str:
    """The output of a function that prints on a console, as HTML in the colours of the page, light or dark."""
    out = _recording_console()
    show(out)
    style = "line-height: normal; overflow-x: auto; font-family: monospace"
    return out.export_html(inline_styles=True, code_format=f'<pre style="{style}">{{code}}</pre>')


def _recording_console() -> _Console:
    options: dict[str, Any] = {"soft_wrap": True, "markup": False, "emoji": False, "force_jupyter": False}
    return _Console(file=StringIO(), record=True, width=HTML_WIDTH, **options)


def show_json(out: Console, tree: Any) -> None:
    """Print one JSON document, in colours on a terminal."""
    text = json_text(tree)
    out.print(JSONHighlighter()(text) if out.is_terminal else Text(text), soft_wrap=True)


MAX_COLUMNS = 10_000
"""Width for a table that is not folded."""

MIN_FOLDED = 8
"""Minimum width of a folded text."""

INDENT = "  "
"""Indent of the lines after the first, but for a part that fits only without it."""

_PIECES = re.compile(r"/?[^/_.,:;-]+[/_.,:;-]*|[/_.,:;-]+")


class Folded:
    """A text that is folded to the available width, after a blank if it has one, else after a mark."""

    def __init__(self, text: str) -> None:
        self.text = visible(text)

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        length = cell_len(self.text)
        return Measurement(min(length, MIN_FOLDED), length).with_maximum(options.max_width)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for line in folded_lines(self.text, options.max_width):
            yield Text(line.strip() if options.justify == "right" else line)


def folded_lines(text: str, width: int) -> Iterator[str]:
    """Lines of at most `width` columns that join to the text, except for blanks at their ends."""
    line = ""
    for position, word in enumerate(text.split(" ")):
        parts = [word] if cell_len(word) <= width - len(INDENT) else _PIECES.findall(word)
        blank = " " if position else ""
        for part in parts:
            if line.strip() and cell_len(line) + len(blank) + cell_len(part) > width:
                yield line
                line = "" if width - len(INDENT) < cell_len(part) <= width else INDENT
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
