"""Commands of lidcam in children of a process that has imported everything: a start takes no time.

One process for each worker of pytest; in the children nothing is different from the installed command but the time that
its imports take. `test_usage`, `test_documents` and `test_wheel` start the program itself.
"""

import atexit
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from command import Run
from less_tracing import PROCESSES

__all__ = ["ForkServer"]

TIMEOUT_S = 300.0
MORE = (
    "lidcam.cli",
    "lidcam.commands.compare",
    "lidcam.commands.config",
    "lidcam.commands.evaluate",
    "lidcam.printing.evaluation",
    "pipeline.detectors.onnx.detector",
    "scipy.sparse.csgraph",
)
"""Modules of other commands than `process`."""


class ForkServer:
    """A process that runs commands one after the other; a context manager.

    Args:
        folder: For what the commands print, and where they run.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._out, self._err = folder, folder / "stdout.txt", folder / "stderr.txt"

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            [sys.executable, __file__, *sys.path],
            cwd=self._folder,
            env={"OMP_NUM_THREADS": "1", **{name: text for name, text in os.environ.items() if name != PROCESSES}},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate()

    def run(self, arguments: Sequence[str]) -> Run:
        """Run `lidcam` with the arguments, to its end."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(self._out), str(self._err), *arguments]) + "\n")
        self._process.stdin.flush()
        code = self._process.stdout.readline()
        assert code, "the process that starts commands has ended"
        return Run(int(code), self._out.read_text(), self._err.read_text())


def _serve() -> None:
    import forked_runs

    forked_runs.load()
    for name in MORE:
        import_module(name)
    for line in iter(sys.stdin.readline, ""):
        out, err, *arguments = json.loads(line)
        pid = os.fork()
        if not pid:
            _child(out, err, arguments)
        print(_wait(pid), flush=True)


def _child(out: str, err: str, arguments: Sequence[str]) -> None:
    from forked_runs import exit_code

    code: Any = 70
    try:
        for path, mode, descriptor in ((os.devnull, os.O_RDONLY, 0), (out, os.O_WRONLY, 1), (err, os.O_WRONLY, 2)):
            os.dup2(os.open(path, mode | os.O_CREAT | (os.O_TRUNC if descriptor else 0), 0o600), descriptor)
        sys.argv = ["lidcam", *arguments]
        from lidcam.__main__ import main

        code = exit_code(main)
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _wait(pid: int) -> int:
    until_s = time.monotonic() + TIMEOUT_S
    while True:
        found, status = os.waitpid(pid, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > until_s:
            os.kill(pid, 9)
        time.sleep(0.002)


if __name__ == "__main__":
    sys.path[:] = sys.argv[1:]
    _serve()
