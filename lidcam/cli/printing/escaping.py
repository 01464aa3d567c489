"""Escapes text for terminals; everything that is printed passes through here.

Names of topics, frames and files, and error texts, may contain control sequences. Unprintable characters are shown as
escape sequences, and URLs without secrets. Libraries and outputs keep the names as they are.
"""

import json
from typing import Any

from lidcam.pipeline.core.text import visible as printable
from lidcam.pipeline.core.urls import without_secrets


def visible(text: str) -> str:
    """A text for one line, escaped, with URLs without secrets."""
    return without_secrets(printable(text))


def visible_lines(text: str) -> str:
    """Several lines, escaped as by `visible`; line ends and tabs are kept."""
    return "\n".join(map(without_secrets, printable_lines(text).split("\n")))


def printable_lines(text: str) -> str:
    """A text of several lines, escaped."""
    return "\n".join("\t".join(map(printable, line.split("\t"))) for line in text.split("\n"))


def json_text(tree: Any) -> str:
    r"""A JSON document, indented: URLs without secrets, all that is not printable as `\u001b` and the like."""
    lines = json.dumps(_without_secrets(tree), indent=2, ensure_ascii=False).split("\n")
    return "\n".join(line if line.isprintable() else _json_escaped(line) for line in lines)


def _without_secrets(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _without_secrets(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [_without_secrets(value) for value in tree]
    return without_secrets(tree) if isinstance(tree, str) else tree


def _json_escaped(line: str) -> str:
    return "".join(letter if letter.isprintable() else json.dumps(letter)[1:-1] for letter in line)
