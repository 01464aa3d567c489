"""The README says what the program does."""

import re
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from lidcam.cli import app, process_app

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
OF_EVERY_COMMAND = {"--help", "--version"}


def options_of_process() -> set[str]:
    return {option for parameter in get_command(process_app).params for option in parameter.opts if option[:2] == "--"}


def test_the_table_of_options_is_complete() -> None:
    table = README.split("| option of `lidcam-process` | |")[1].split("\n\n")[0]
    assert set(re.findall(r"--[a-z][a-z0-9-]+", table)) == options_of_process() - OF_EVERY_COMMAND


def commands_in_the_readme() -> list[str]:
    inline = re.findall(r"`(lidcam[- ][^`\n]* [^`\n]*)`", README)
    blocks = [line for block in re.findall(r"```\n(.*?)```", README, re.DOTALL) for line in block.splitlines()]
    return [re.split(r"   ", c)[0] for c in inline + blocks if c.startswith(("lidcam ", "lidcam-process "))]


def test_the_readme_has_commands() -> None:
    assert len(commands_in_the_readme()) >= 3


@pytest.mark.parametrize("command", commands_in_the_readme())
def test_commands_in_the_readme_are_right_usage(command: str) -> None:
    program, *arguments = shlex.split(command)
    parser = get_command(process_app if program == "lidcam-process" else app)
    context = parser.make_context(program, arguments, resilient_parsing=False)
    if program == "lidcam":
        name, child, rest = parser.resolve_command(context, [*context._protected_args, *context.args])  # type: ignore[attr-defined]  # a group
        child.make_context(name, rest)


@pytest.mark.parametrize("target", sorted(set(re.findall(r"`make (\w+)`", README))))
def test_make_targets_exist(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize(
    "path", sorted(set(re.findall(r"\b(?:config|docs|pipeline|bags)/[\w/.]+\.(?:md|py|yaml|bag)\b", README)))
)
def test_named_files_exist(path: str) -> None:
    assert (ROOT / path).is_file()
