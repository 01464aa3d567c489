"""What is printed on a console as text, and as HTML for notebooks."""

from io import StringIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # rich takes 30 ms
    from rich.console import Console, RenderableType

HTML_WIDTH = 300
"""Characters of a line: a page can be scrolled."""


def as_text(*parts: "RenderableType") -> str:
    """Texts and tables as they stand on a wide terminal, without its codes."""
    out = _console()
    for part in parts:
        out.print(part)
    return "\n".join(line.rstrip() for line in out.export_text().splitlines())


def as_html(*parts: "RenderableType") -> str:
    """Texts and tables as HTML."""
    out = _console()
    for part in parts:
        out.print(part)
    return recorded_html(out)


def recorded_html(out: "Console") -> str:
    """What was printed on a console that records, as HTML; in the colours of the page, light or dark."""
    style = "line-height: normal; overflow-x: auto; font-family: monospace"
    return out.export_html(inline_styles=True, code_format=f'<pre style="{style}">{{code}}</pre>')


def _console() -> "Console":
    from rich.console import Console

    return Console(
        file=StringIO(), record=True, width=HTML_WIDTH, markup=False, emoji=False, highlight=False, force_jupyter=False
    )
