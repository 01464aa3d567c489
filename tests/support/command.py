"""Commands of lidcam, called in this process, or several in one other: to start a program takes longer."""

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from unittest.mock import patch

from logging_state import kept_logging
from typer.main import get_command

from lidcam.__main__ import main, main_process

COMMAND_OF = cache(get_command)
"""A program calls itself once; tests need not read all options anew for each call."""


@dataclass(frozen=True)
class Run:
    """A finished command."""

    code: int
    out: str
    err: str

    @property
    def error_line(self) -> str:
        """The one line that says what went wrong."""
        assert "Traceback" not in self.err, self.err
        lines = [line for line in self.err.splitlines() if line.startswith("lidcam: error:")]
        assert len(lines) == 1, self.err
        return lines[0]


Lidcam = Callable[..., Run]
"""Calls the command, from another folder."""


def called(folder: Path, *arguments: object, program: str = "lidcam") -> Run:
    """Call a program with these arguments, from a folder, to its end. Signals stay the caller's."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        kept_logging(),
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        patch.object(sys, "argv", [program, *map(str, arguments)]),
        patch.dict(os.environ, {"OMP_NUM_THREADS": "1"}),
        patch("lidcam.__main__.end_at_signals"),
        patch("typer.main.get_command", COMMAND_OF),
    ):
        try:
            main() if program == "lidcam" else main_process()
        except SystemExit as end:
            code = int(end.code or 0)
    return Run(code, out.getvalue(), err.getvalue())


def shell(line: str, folder: Path, **environment: str) -> Run:
    """Run a line of bash in a folder."""
    command, variables = ["bash", "-e", "-o", "pipefail", "-c", line], os.environ | environment
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    return Run(done.returncode, done.stdout, done.stderr)


CALLS = """
import json, sys
from pathlib import Path
from command import called

print(json.dumps([vars(called(Path(), *command)) for command in json.loads(sys.argv[1])]))
"""


def called_apart(folder: Path, prepare: str, *commands: tuple[object, ...]) -> list[Run]:
    """Call commands from a folder, in one process of their own that does something else before, with its modules."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    program = [sys.executable, "-c", prepare + CALLS, json.dumps(commands, default=str)]
    done = subprocess.run(program, env=environment, cwd=folder, stdout=subprocess.PIPE, check=True).stdout
    return [Run(**one) for one in json.loads(done)]
