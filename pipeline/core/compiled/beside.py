"""Other processes that compile while this one does: the first run on a machine waits for the shorter part.

Each goes through all files with compiled functions, the others from the last file to the first, and takes what any of
them has kept so far. They end with the block in which they are wanted, and with the process that started them.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from threading import Thread

__all__ = ["compiled_beside", "kernel_modules", "serve", "start_others"]

MAX_PROCESSES = 8
"""Each holds 200 MB and takes a second to begin; more of them than this save nothing."""

_IMPORT = "from pipeline.core.compiled import "
_SERVE = "from pipeline.core.compiled.beside import serve; serve()"

_wanted = 0
_running: list[subprocess.Popen[bytes]] = []


@contextmanager
def compiled_beside(processes: int) -> Iterator[None]:
    """Within the block, processes share the work if something has to be compiled; nothing is started otherwise.

    Args:
        processes: How many at most, this one among them.
    """
    global _wanted
    _wanted = min(processes, MAX_PROCESSES) - 1
    try:
        yield
    finally:
        _wanted = 0
        while _running:
            process = _running.pop()
            assert process.stdin is not None
            process.stdin.close()
            process.wait()


def start_others() -> None:
    """Start the processes that are wanted; called once something was compiled and could be kept."""
    global _wanted
    count, _wanted = _wanted, 0
    modules = kernel_modules()[::-1] if count > 0 else []
    for number in range(min(count, len(modules))):
        with suppress(OSError):  # then this process does it all
            _running.append(
                subprocess.Popen(
                    [sys.executable, "-P", "-c", _SERVE, *modules[number::count]],
                    env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )


def kernel_modules() -> list[str]:
    """Names of the modules with compiled functions, sorted."""
    root = Path(__file__).parents[2]
    return sorted(
        ".".join(path.relative_to(root.parent).with_suffix("").parts)
        for path in root.rglob("*.py")
        if f"\n{_IMPORT}" in path.read_text(encoding="utf-8")
    )


def serve() -> None:
    """In such a process: compile what the modules have that are its arguments, until its standard input ends."""
    Thread(target=_end_with_input, daemon=True).start()
    for name in sys.argv[1:]:
        import_module(name)


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(0)
