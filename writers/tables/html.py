"""Console output as text, and as HTML for notebooks."""

from collections.abc import Iterable, Sequence
from html import escape
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


def scrolling_table(head: str, names: Sequence[str], rows: Iterable[Sequence[str]], foot: str = "") -> str:
    """A table of texts as HTML: its rows scroll below the names of the columns, in the colours of the notebook."""
    cell = 'style="text-align: right; white-space: nowrap; padding: 0.1em 0.6em"'
    top = 'style="position: sticky; top: 0; background: var(--jp-layout-color1, Canvas)"'
    body = "".join(f"<tr>{''.join(f'<td {cell}>{escape(text)}</td>' for text in row)}</tr>" for row in rows)
    names_row = "".join(f"<th {cell}>{escape(name)}</th>" for name in names)
    return (
        f"<div>{escape(head)}</div>"
        '<div style="max-height: 22em; overflow: auto; max-width: 100%">'
        f"<table><thead {top}><tr>{names_row}</tr></thead><tbody>{body}</tbody></table></div>"
        f"<div>{escape(foot)}</div>"
    )


def recorded_html(out: "Console") -> str:
    """The output of a recording console as HTML, in the colours of the page, light or dark."""
    style = "line-height: normal; overflow-x: auto; font-family: monospace"
    return out.export_html(inline_styles=True, code_format=f'<pre style="{style}">{{code}}</pre>')


def _console() -> "Console":
    from rich.console import Console

    return Console(
        file=StringIO(), record=True, width=HTML_WIDTH, markup=False, emoji=False, highlight=False, force_jupyter=False
    )
