"""The commands that the documents and the help texts name."""

import re
from functools import cache
from pathlib import Path
from typing import Any

from helpers import BAGS, ROOT
from typer.main import get_command

from lidcam.cli import app

PROGRAMS = ("lidcam", "lidcam-process", "pip", "make", "rerun", "python", "python3", "apt-get")

_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
_INLINE = re.compile(r"(?<!`)`([^`]+)`(?!`)")


def pages() -> list[Path]:
    """All documents."""
    return [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "SECURITY.md",
        BAGS / "README.md",
        *sorted(ROOT.glob("docs/**/*.md")),
    ]


@cache
def commands_of_pages() -> dict[str, str]:
    """Each command once, with the page that names it first."""
    found: dict[str, str] = {}
    for page in pages():
        text = page.read_text(encoding="utf-8")
        for language, block in _BLOCK.findall(text):
            if language in {"", "sh", "bash", "console"}:
                for line in block.splitlines():
                    command = re.split(r"\s{3,}|\s+#", line.removeprefix("$ "))[0]  # what follows explains it
                    if command.split(" ")[0] in PROGRAMS:
                        found.setdefault(command, page.name)
        for paragraph in _BLOCK.sub("", text).split("\n\n"):
            for code in _INLINE.findall(paragraph):
                command = " ".join(code.split())
                if _is_whole(command):
                    found.setdefault(command, page.name)
    return found


@cache
def commands_of_help() -> dict[str, str]:
    """The examples of `--help`."""
    commands: dict[str, Any] = dict(get_command(app).commands)  # type: ignore[attr-defined]  # a group
    found = {}
    while commands:
        name, command = commands.popitem()
        commands |= getattr(command, "commands", {})
        for line in (command.epilog or "").splitlines():
            if line.startswith("  lidcam"):
                found[line.strip()] = f"{name} --help"
    return found


def _is_whole(command: str) -> bool:
    """Whether code in a sentence is a command, and not the name of one: `make`, `lidcam inspect`, `lidcam drive X`."""
    program, *arguments = command.split(" ")
    if program == "lidcam" and arguments and not arguments[0].startswith("-"):
        return len(arguments) >= (3 if arguments[0] in {"simulate", "drive"} else 2)
    return program in PROGRAMS and bool(arguments)
