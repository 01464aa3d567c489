"""A console that prints text as it is, with control characters made visible."""

import os
from collections.abc import Callable, Iterable
from io import StringIO
from typing import Any, Literal

from rich.console import Console, ConsoleOptions, RenderableType
from rich.highlighter import JSONHighlighter
from rich.segment import Segment
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
