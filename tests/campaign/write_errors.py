"""An error of the system at every call of a short run that writes to the folder of its outputs, one after the other.

Opening for writing, write, fsync, close, rename, link, mkdir and chmod fail with EIO, ENOSPC, EDQUOT or EROFS, once or,
as on a full disk, from then on. A library that is preloaded does it (`write_errors.c`, compiled here; needs cc), so
native code is disturbed, too: Rerun's and SQLite's. Each run has to end with one line and what stood there before, or
with all of its outputs, whole, and in either case with nothing else. Memory that is mapped is not covered.
"""

import ctypes
import errno
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from common import Outcome, campaign
from outputs import KINDS, Kind, begin, content, home, made, names, version_of

TEST_COUNT = 3
COUNT = 1600
"""A run makes at most 200 of these calls, of eight kinds; those that make fewer get other errors in a second turn."""
IN_CHILD = "LIDCAM_CAMPAIGN_CHILD"
SOURCE = Path(__file__).with_name("write_errors.c")
ERRORS = (errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def armed(folder: Path, nth: int, number: int, *, is_sticky: bool, told: Path) -> Callable[[], None]:
    """Prepares a run whose N-th call fails; at its end it tells how many calls there were, and how many failed."""

    def prepare() -> None:
        import atexit

        library = ctypes.CDLL(None)
        library.write_errors_arm(os.fsencode(folder), ctypes.c_long(nth), number, int(is_sticky))

        def tell() -> None:
            counts = [library.write_errors_calls(), library.write_errors_failures()]
            library.write_errors_arm(b"", ctypes.c_long(0), 0, 0)
            told.write_text(json.dumps(counts))

        atexit.register(tell)

    return prepare


@cache
def calls_of(kind: Kind, *, has_old: bool) -> int:
    """How many calls a run makes, of which the N-th is to fail."""
    folder = Path(tempfile.mkdtemp(dir=home())) / "out"
    told = folder.with_name("told.json")
    place(kind, folder, has_old=has_old)
    counting = armed(folder, 0, 0, is_sticky=False, told=told)
    ended = begin(kind, "new", folder, home() / "rec.mcap", counting).wait()
    assert ended.code == 0, ended.err
    return int(json.loads(told.read_text())[0])


def place(kind: Kind, folder: Path, *, has_old: bool) -> None:
    """Make the folder of the outputs, with those of an earlier run or without."""
    if has_old:
        shutil.copytree(made(kind, "old"), folder)
    else:
        folder.mkdir()


def try_case(number: int, chance: Random) -> Outcome:
    """Let one call fail."""
    kind, has_old, turn = KINDS[number % 4], bool(number // 4 % 2), number // 8
    nth = 1 + turn % calls_of(kind, has_old=has_old)
    code, is_sticky = chance.choice(ERRORS), chance.random() < 0.3
    base = Path(tempfile.mkdtemp(dir=home()))
    folder, told = base / "out", base / "told.json"
    try:
        place(kind, folder, has_old=has_old)
        before = {name: content(folder / name) for name in kind.outputs}
        prepare = armed(folder, nth, code, is_sticky=is_sticky, told=told)
        run = begin(kind, "new", folder, home() / "rec.mcap", prepare).wait()
        versions = [version_of(kind, name, folder, before) for name in kind.outputs]
        seen = names(folder)
        failed = json.loads(told.read_text())[1] if told.exists() else 0
        detail = (
            f"{kind.name}, old outputs {has_old}, call {nth} fails with {errno.errorcode[code]}, sticky {is_sticky}: "
            f"exit code {run.code}, {failed} calls failed, {versions}, {seen}\n{run.err}"
        )
        return judged(kind, run, versions, seen, before, failed, detail)
    finally:
        shutil.rmtree(base)


def judged(
    kind: Kind,
    run: Any,
    versions: list[str],
    seen: list[str],
    before: dict[str, str | None],
    failed: int,
    detail: str,
) -> Outcome:
    """Whether all of it is as promised."""
    if run.is_hung:
        return Outcome("hang", is_fault=True, detail=detail)
    if "Traceback" in run.err:
        return Outcome("traceback", is_fault=True, detail=detail)
    versions = [version for version in versions if version != "before or new"]
    if run.code == 0:
        if set(versions) - {"new"} or seen != sorted(kind.outputs):
            return Outcome("exit code 0 without whole outputs", is_fault=True, detail=detail)
        return Outcome("whole outputs" if failed else "the call was not made")
    if not run.is_one_line:
        return Outcome("not one line", is_fault=True, detail=detail)
    if set(versions) - {"before"}:
        return Outcome("an output of a failed run", is_fault=True, detail=detail)
    if seen != sorted(name for name, found in before.items() if found is not None):
        return Outcome("leftovers of a failed run", is_fault=True, detail=detail)
    return Outcome("one line, as before")


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code; runs in a process of its own with the library preloaded, which forks for every case."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if IN_CHILD not in os.environ:
        if shutil.which("cc") is None:
            print("write_errors: needs cc; nothing was tried")
            return 0
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "write_errors.so"
            subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, SOURCE, "-ldl"], check=True)
            variables = os.environ | {IN_CHILD: "1", "LD_PRELOAD": str(library)}
            return subprocess.run([sys.executable, __file__, *given], env=variables, check=False).returncode
    try:
        return campaign("write_errors", try_case, count=COUNT, arguments=given)
    finally:
        shutil.rmtree(home(), ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
