"""Full disks: `python tests/campaign/full_disks.py [--minutes M | --count N] [--seed S]`.

Each case runs a command whose outputs (or temporary files, or standard output) lie on a small disk of its own (tmpfs),
anything from empty to a little more than it takes. Where none may be mounted, the size of files is limited instead.
Either all outputs are there and whole, or what stood there before stands and one line says why, with exit code 1.
Nothing else may be left, and nothing may wait for ever.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from random import Random

from common import LIDCAM, Child, Outcome, campaign, run_child  # isort: skip
from rerun.chunk import RrdReader
from small_drive import small_inputs

__all__ = ["TEST_COUNT", "main", "small_disk"]

TEST_COUNT = 1
TIMEOUT_S = 120.0
SPARE = 1.2
"""Disks are at most so much larger than what is written."""

UNPACKING_RESERVE = 1 << 28
"""Of a disk for temporary files, lidcam leaves so much free."""

Files = Mapping[str, str]
"""Digests by name."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A command.

    Attributes:
        arguments: Of lidcam; `{in}` is a recording, `{out}` the folder of the outputs.
        recording: Which recording.
        full: What is full.
    """

    arguments: str
    recording: str
    full: str = "outputs"


KINDS = (
    Kind("inspect {in} --repair {out}/out.mcap", "damaged.mcap"),
    Kind("process {in} {out}/out.mcap --rerun {out}/out.rrd", "drive.mcap"),
    Kind("process {in} {out}/out.mcap", "drive.mcap"),
    Kind("process {in} {out}/out.mcap --rerun {out}/out.rrd --workers 1", "drive.mcap"),
    Kind("simulate {in} {out}/out.bag --duration 0.3 --workers 1", "small.yaml"),
    Kind("process {in} {out}/out.mcap --rerun {out}/out.rrd", "drive.mcap"),
    Kind("process {in} {out}/out.mcap", "drive.mcap.zstd", "temporary files"),
    Kind("simulate {in} {out}/out.mcap --duration 0.3 --workers 2", "small.yaml"),
    Kind("process {in} {out}/out.mcap --rerun {out}/out.rrd", "drive.mcap", "standard output"),
    Kind("simulate {in} {out}/out --duration 0.3 --workers 1", "small.yaml"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign."""
    if not _may_mount():
        sys.stderr.write("no disks may be mounted here: the size of files is limited instead\n")
    return campaign("full_disks", _try_case, count=40, arguments=arguments, max_case_s=5 * TIMEOUT_S)


def _try_case(number: int, chance: Random) -> Outcome:
    kind = KINDS[number % len(KINDS)]
    needed, expected = _whole(kind)
    has_older = chance.random() < 0.5
    size = round(chance.uniform(0, SPARE) * needed)
    if kind.full == "temporary files" and chance.random() < 0.7:
        size += UNPACKING_RESERVE
    with tempfile.TemporaryDirectory(prefix="full_disks-") as base:
        if kind.full != "outputs":
            out = Path(base, "out")
            out.mkdir()
            with small_disk(Path(base), size) as (disk, limit):
                full = {"TMPDIR": str(disk)} if kind.full == "temporary files" else {}
                wrapper = _sh('exec "$@" >/dev/full') if kind.full == "standard output" else limit
                return _judge(kind, out, {}, expected, _run(kind, out, wrapper, full))
        older = _older(kind) if has_older else {}
        room = sum(len(data) // 4096 * 4096 + 8192 for data in older.values()) + 65536 if older else 0
        with small_disk(Path(base), size + room) as (disk, limit):
            for name, data in older.items():
                (disk / name).parent.mkdir(exist_ok=True)
                (disk / name).write_bytes(data)
            return _judge(kind, disk, _files(disk), expected, _run(kind, disk, limit, {}))


def _judge(kind: Kind, out: Path, before: Files, expected: Files, child: Child) -> Outcome:
    name = f"{kind.arguments.split(maxsplit=1)[0]}, full {kind.full}"
    after = _files(out)
    detail = f"{kind}\nexit code {child.returncode}, {child.seconds:.1f} s\nbefore {before}\nafter {after}\n"
    detail += f"expected {expected}\n{child.stderr}"
    if child.is_hung:
        return Outcome(f"{name}: hang", is_fault=True, detail=detail)
    if child.has_traceback:
        return Outcome(f"{name}: traceback", is_fault=True, detail=detail)
    is_whole = after == expected
    if not is_whole and after != before:
        return Outcome(f"{name}: half outputs or leftovers", is_fault=True, detail=detail)
    if child.returncode in {0, 3} and kind.full != "standard output":
        kept = f"{name}: whole" if is_whole else f"{name}: exit code {child.returncode} without outputs"
        return Outcome(kept, is_fault=not is_whole, detail=detail)
    lines = child.stderr.splitlines()
    is_told = sum(line.startswith("lidcam: error: ") for line in lines) == 1
    is_told = is_told and all(line.startswith(("lidcam: ", "wrote ")) for line in lines)
    if child.returncode != 1 or not is_told:
        return Outcome(f"{name}: exit code {child.returncode}, {len(lines)} lines", is_fault=True, detail=detail)
    return Outcome(f"{name}: one line, {'whole' if is_whole else 'as before'}", detail=detail)


def _run(kind: Kind, out: Path, wrapper: Sequence[str], env: Mapping[str, str]) -> Child:
    found = {"in": small_inputs() / kind.recording, "out": out}
    arguments = [part.format_map(found) for part in kind.arguments.split()]
    return run_child([*wrapper, *LIDCAM, *arguments], timeout_s=TIMEOUT_S, env=env)


@cache
def _whole(kind: Kind) -> tuple[int, Files]:
    """Bytes of the outputs (or what is unpacked) where there is space, and the outputs."""
    with tempfile.TemporaryDirectory(prefix="full_disks-") as folder:
        child = _run(kind, Path(folder), (), {})
        if child.returncode not in {0, 3}:
            raise RuntimeError(f"{kind} does not work with space enough: {child.stderr}")
        if kind.full == "temporary files":
            return (small_inputs() / "drive.mcap").stat().st_size, _files(Path(folder))
        return sum(path.stat().st_size for path in Path(folder).rglob("*")), _files(Path(folder))


@cache
def _older(kind: Kind) -> dict[str, bytes]:
    """Outputs of an earlier run, which differ from those of the command."""
    command = kind.arguments.split(maxsplit=1)[0]
    other = {"process": " --duration 2", "simulate": " --seed 5"}.get(command, "")
    recording = "drive.mcap" if command == "inspect" else kind.recording
    with tempfile.TemporaryDirectory(prefix="full_disks-") as folder:
        _run(replace(kind, arguments=kind.arguments + other, recording=recording), Path(folder), (), {})
        paths = [path for path in Path(folder).rglob("*") if path.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def _files(folder: Path) -> Files:
    """What lies in a folder: digests, but of Rerun recordings (which hold random numbers) the rows."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir():
            found[name] = "folder"
        elif path.suffix == ".rrd":
            found[name] = _rows(path)
        else:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    return found


def _rows(path: Path) -> str:
    try:
        chunks = list(RrdReader(str(path)).store().stream())
    except Exception as err:
        return f"cannot be read: {err}"
    return f"{sum(chunk.num_rows for chunk in chunks)} rows of {len({str(chunk.entity_path) for chunk in chunks})}"


@contextmanager
def small_disk(base: Path, size: int) -> Iterator[tuple[Path, Sequence[str]]]:
    """A folder on a disk of a size in bytes, and how to start a command that writes to it.

    Args:
        base: A fresh folder, in which the disk is mounted.
        size: Its size; rounded up to pages.
    """
    disk = base / "disk"
    disk.mkdir()
    if not _may_mount():
        yield disk, _sh(f'ulimit -f {max(size // 512, 1)}; exec "$@"')
        return
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={max(size, 4096)}", "tmpfs", disk], check=True)
    try:
        yield disk, ()
    finally:
        # Lazily if a process that was killed has not yet gone: the folder must be empty before it is removed.
        if subprocess.run(["umount", disk], capture_output=True, check=False).returncode:
            subprocess.run(["umount", "--lazy", disk], check=True)


@cache
def _may_mount() -> bool:
    if os.geteuid():
        return False
    with tempfile.TemporaryDirectory(prefix="full_disks-") as folder:
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], capture_output=True, check=False
        )
        if mounted.returncode == 0:
            subprocess.run(["umount", folder], check=True)
        return mounted.returncode == 0


def _sh(line: str) -> list[str]:
    """A shell that runs a line, in which `"$@"` is the command."""
    return ["sh", "-c", line, "sh"]


if __name__ == "__main__":
    sys.exit(main())
