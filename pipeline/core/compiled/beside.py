"""Other processes that compile while this one does: the first run on a machine waits for the shorter part.

Each goes through all files with compiled functions, the others from the last file to the first, and takes what any of
them has kept so far. They end with the block in which they are wanted, and with the process that started them.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from threading import Thread

from lidcam.pipeline.core.compile_log import compile_log

Progress = Callable[[int, int], object]
"""Called with the number of functions that are compiled by now, and the number of all."""

MAX_PROCESSES = 8
"""Each holds 200 MB and takes a second to start; more of them than this save nothing."""

_ROOT = Path(__file__).parents[4]
_IMPORT = "from lidcam.pipeline.core.compiled import "
_SERVE = "from lidcam.pipeline.core.compiled.beside import serve; serve()"


@dataclass
class _FirstRun:
    """State of compiling in this process."""

    wanted: int = 0
    progress: Progress | None = None
    is_logged: bool = False
    running: list[subprocess.Popen[bytes]] = field(default_factory=list)


_first_run = _FirstRun()


@contextmanager
def compiled_beside(processes: int, progress: Progress | None = None) -> Iterator[None]:
    """Within the block, processes share the work if something has to be compiled; nothing is started otherwise.

    Args:
        processes: How many at most, this one among them.
        progress: Called after each function that this process had to compile.
    """
    _first_run.wanted, _first_run.progress = min(processes, MAX_PROCESSES) - 1, progress
    try:
        yield
    finally:
        _first_run.wanted, _first_run.progress = 0, None
        while _first_run.running:
            process = _first_run.running.pop()
            assert process.stdin is not None
            process.stdin.close()
            process.wait()


def one_compiled(folder: Path | None) -> None:
    """Say so, and have others help if they are wanted.

    Args:
        folder: Where functions are kept; None: they are not, so that nobody can help.
    """
    if not _first_run.is_logged:
        _first_run.is_logged = True
        compile_log.info("compiling for this processor, once: up to a minute")
    if folder is None:
        return
    _start_others()
    if _first_run.progress:
        total = sum(text.count("\n@compiled(") for _, text in kernel_sources())
        _first_run.progress(min(sum(1 for _ in folder.rglob("*.nbi")), total), total)


def _start_others() -> None:
    count, _first_run.wanted = _first_run.wanted, 0
    paths = [path for path, _ in kernel_sources()][::-1] if count > 0 else []
    modules = [".".join(path.relative_to(_ROOT).with_suffix("").parts) for path in paths]
    for number in range(min(count, len(modules))):
        with suppress(OSError):  # then this process does it all
            _first_run.running.append(
                subprocess.Popen(
                    [sys.executable, "-P", "-c", _SERVE, *modules[number::count]],
                    env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )


def kernel_sources() -> list[tuple[Path, str]]:
    """The files with compiled functions, and their texts, sorted by path."""
    texts = ((path, path.read_text(encoding="utf-8")) for path in sorted((_ROOT / "lidcam" / "pipeline").rglob("*.py")))
    return [(path, text) for path, text in texts if f"\n{_IMPORT}" in text]


def serve() -> None:
    """In such a process: compile what the modules have that are its arguments, until its standard input ends."""
    Thread(target=_end_with_input, daemon=True).start()
    for name in sys.argv[1:]:
        import_module(name)


def _end_with_input() -> None:
    os.read(0, 1)  # not sys.stdin, whose lock this thread would hold while the interpreter ends
    os._exit(0)
