"""lidcam in a program without what Windows lacks: it reads there. Nobody has run it under Windows itself."""

import subprocess
import sys
import textwrap
from pathlib import Path

from helpers import SANDBOX

AS_WINDOWS = """
import asyncio, builtins, os, signal, subprocess, sys  # they look for what they need when they are imported
import cv2, mcap.reader, multiprocessing, numpy, onnxruntime, pydantic, rich.console, rosbags, tempfile, typer, yaml

imported = builtins.__import__
missing = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}


def guarded(name, globals=None, *rest, **more):
    if name.partition(".")[0] in missing and (globals or {}).get("__name__", "").startswith("lidcam"):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return imported(name, globals, *rest, **more)


builtins.__import__ = guarded
for module, names in {
    os: "O_NOFOLLOW O_NONBLOCK O_CLOEXEC fork geteuid getuid pread sched_getaffinity statvfs sysconf sysconf_names",
    signal: "SIGHUP SIGKILL SIGUSR1 pthread_sigmask",
}.items():
    for name in names.split():
        delattr(module, name)
"""


def as_windows(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    whole = AS_WINDOWS + textwrap.dedent(code)
    command = [sys.executable, "-c", whole, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_module_is_imported() -> None:
    """But for those that need a library of an extra, which may lack things itself."""
    done = as_windows("""
        import importlib, pkgutil
        import lidcam

        extras = ("bags.simulator", "training", "live", "batch.ray", "rerun", "images.film", "notebook")
        names = [one.name for one in pkgutil.walk_packages(lidcam.__path__, "lidcam.") if "__main__" not in one.name]
        assert len(names) > 300
        for name in names:
            if not any(f".{extra}" in name for extra in extras):
                importlib.import_module(name)
        print("all")
    """)
    assert (done.returncode, done.stdout) == (0, "all\n"), done.stderr


def test_it_reads_into_memory_and_says_in_one_line_what_it_does_not(tmp_path: Path) -> None:
    code = """
        import lidcam
        from lidcam.__main__ import main
        from lidcam.pipeline.parallel.cores import usable_cores
        from lidcam.pipeline.parallel.process import WorkerProcess

        print(len(lidcam.process(sys.argv[2], duration_s=0.3, settings=["detect3d.method=cluster"]).objects))
        assert usable_cores() == 1
        try:
            WorkerProcess()
        except Exception as err:
            print(err)
        main()
    """
    done = as_windows(code, "process", SANDBOX, tmp_path / "out.mcap")
    objects, workers = done.stdout.splitlines()[-2:]
    assert int(objects) > 0, done.stderr
    assert workers.endswith("found Windows: set run.workers=1")
    assert done.returncode == 1
    assert "found Windows, where lidcam only reads: run it in WSL" in done.stderr.splitlines()[-1]
    assert [*tmp_path.iterdir()] == []
