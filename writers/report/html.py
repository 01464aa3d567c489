"""Pieces of HTML, with all text escaped."""

from collections.abc import Iterable, Sequence
from html import escape
from string import Template
from typing import Any

from lidcam.pipeline.core.text import visible


class Raw(str):
    """Text that is HTML already."""

    __slots__ = ()


def text(value: Any) -> Raw:
    """A value as HTML."""
    return value if isinstance(value, Raw) else Raw(escape(visible(str(value))))


def text_block(value: str) -> Raw:
    """Text with its line ends as HTML."""
    return Raw("\n".join(text(line) for line in value.splitlines()))


def paragraph(value: Any, kind: str = "") -> Raw:
    """A paragraph; of a kind that the style sheet knows."""
    return Raw(f'<p class="{kind}">{text(value)}</p>' if kind else f"<p>{text(value)}</p>")


def table(head: Sequence[str], rows: Iterable[Sequence[Any]], words: Iterable[int] = (0,)) -> Raw:
    """A table that scrolls by itself where it is wider than the page; empty without rows.

    Args:
        head: Names of the columns.
        rows: The cells.
        words: Columns of words, which stand left; numbers stand right.
    """
    left = set(words)

    def cells(tag: str, row: Sequence[Any]) -> str:
        return "".join(
            f"<{tag}>{text(cell)}</{tag}>" if column in left else f'<{tag} class="n">{text(cell)}</{tag}>'
            for column, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    if not body:
        return Raw()
    return Raw(
        f'<div class="wide"><table><thead><tr>{cells("th", head)}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def section(name: str, title: str, *parts: Raw) -> Raw:
    """A section with a heading; empty without content."""
    content = "".join(parts)
    return Raw(f'<section id="{name}"><h2>{text(title)}</h2>{content}</section>') if content else Raw()


def more(title: str, content: Raw) -> Raw:
    """What is shown when somebody asks for it."""
    return Raw(f"<details><summary>{text(title)}</summary>{content}</details>") if content else Raw()


def figure(name: str, title: str, note: str = "") -> Raw:
    """The place of a plot of that name."""
    head, told = f"<h3>{text(title)}</h3>" if title else "", f"<p>{text(note)}</p>" if note else ""
    return Raw(f'<figure><figcaption>{head}{told}</figcaption><div class="plot" id="{name}"></div></figure>')


def image(source: str, caption: str) -> Raw:
    """An image with what it shows."""
    return Raw(
        f'<figure class="tile"><img src="{source}" alt="{text(caption)}"><figcaption>{text(caption)}'
        "</figcaption></figure>"
    )


def filled(template: str, **parts: str) -> str:
    """A template with its parts."""
    return Template(template).substitute(parts)
