"""A data set may bring anything beside an output: nothing outside the output's folder changes, and nothing waits."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from command import called
from helpers import SANDBOX
from written_jobs import Written

from lidcam.batches.jobs import RECORDS, find_jobs
from lidcam.batches.run import BatchOptions, run_batch
from lidcam.batches.store import TABLE, Store, records_table
from lidcam.pipeline.core.errors import OutputError
from lidcam.run.job import Job
from lidcam.writers.outputs.transaction import OutputTransaction


def deep(path: Path, home: Path) -> None:
    (path / "a" / "b").mkdir(parents=True)
    (path / "a" / "link").symlink_to(home)


def full(path: Path, _: Path) -> None:
    path.mkdir()
    (path / "file").write_text("planted")


def foreign(path: Path, _: Path) -> None:
    path.write_text("planted")
    os.chown(path, 1000, 1000)


KINDS: dict[str, Callable[[Path, Path], object]] = {
    "nothing": lambda _path, _home: None,
    "file": lambda path, _: path.write_text("planted"),
    "hard link": lambda path, home: path.hardlink_to(home / "precious"),
    "empty folder": lambda path, _: path.mkdir(),
    "folder": full,
    "deep folder": deep,
    "link to a file": lambda path, home: path.symlink_to(home / "precious"),
    "link to a folder": lambda path, home: path.symlink_to(home),
    "link to nothing": lambda path, home: path.symlink_to(home / "new"),
    "pipe": lambda path, _: os.mkfifo(path),
    "socket": lambda path, _: os.mknod(path, stat.S_IFSOCK | 0o600),
}
if os.geteuid() == 0:
    KINDS["device"] = lambda path, _: os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 3))
    KINDS["of another user"] = foreign

LEFT = ".out.mcap.lidcam-left"
PLACES = ("out.mcap", "out.rrd", LEFT, f"{LEFT}/other", f"{LEFT}/out.mcap.old")


def plant_folders(folder: Path, home: Path) -> None:
    """200 folders and more: each kind in each place, and each kind of a lock beside each kind of an output."""
    for kind, plant in KINDS.items():
        for place in PLACES:
            path = folder / f"{kind} as {place.replace('/', ' ')}" / place
            path.parent.mkdir(parents=True)
            plant(path, home)
            if path.parent.name == LEFT:
                (path.parent / "out.mcap.lock").touch()
        for lock, plant_lock in KINDS.items():
            left = folder / f"{lock} locks {kind}" / LEFT
            left.mkdir(parents=True)
            plant(left / "out.mcap", home)
            plant_lock(left / "out.mcap.lock", home)


def seen(folder: Path) -> dict[str, tuple[bytes, int, int, int]]:
    """All below a folder: content or target of a link, mode with the kind, owner, time of the last change."""
    found: dict[str, tuple[bytes, int, int, int]] = {}
    for path in sorted(folder.rglob("*")):
        status, content = path.lstat(), b""
        if stat.S_ISREG(status.st_mode):
            content = path.read_bytes()
        elif stat.S_ISLNK(status.st_mode):
            content = os.fsencode(path.readlink())
        found[str(path.relative_to(folder))] = (content, status.st_mode, status.st_uid, status.st_mtime_ns)
    return found


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder of the user, which is to stay as it is."""
    home = tmp_path / "home"
    (home / "inner").mkdir(parents=True)
    (home / "precious").write_text("mine")
    (home / "inner" / "out.mcap").write_text("mine, too")
    return home


def test_200_folders(tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)  # 500 times a disk's pause
    (tmp_path / "planted").mkdir()
    plant_folders(tmp_path / "planted", home)
    at_home = seen(home)
    folders = sorted((tmp_path / "planted").iterdir())
    assert len(folders) >= 200
    for folder in folders:
        paths, before = [folder / "out.mcap", folder / "out.rrd"], seen(folder)
        if error := refusal(paths):
            assert folder.name.endswith(("as out.mcap", "as out.rrd")), error
            assert "\n" not in error
            assert seen(folder) == before
        else:
            assert [path.read_text() for path in paths] == ["whole"] * 2
            stays = {} if is_of_a_run(before) else {name: facts for name, facts in before.items() if name[0] == "."}
            assert {name: facts for name, facts in seen(folder).items() if name[0] == "."} == stays, folder.name
        assert seen(home) == at_home, folder.name


def refusal(paths: list[Path]) -> str:
    """Write outputs; the error, if any."""
    try:
        with OutputTransaction(paths) as outputs:
            for path in paths:
                outputs[path].write_text("whole")
    except OutputError as err:
        return str(err)
    return ""


def is_of_a_run(before: dict[str, tuple[bytes, int, int, int]]) -> bool:
    """Whether a leftover is there that is empty, or has a lock and an output of plain files."""
    kinds = {name: stat.S_IFMT(facts[1]) for name, facts in before.items()}
    is_folder = kinds.pop(LEFT, 0) == stat.S_IFDIR
    has_lock = not kinds or f"{LEFT}/out.mcap.lock" in kinds
    if kinds.get(f"{LEFT}/out.mcap") == stat.S_IFDIR:
        del kinds[f"{LEFT}/out.mcap"]
    is_mine = all(facts[2] == os.geteuid() for facts in before.values())
    return is_folder and has_lock and is_mine and {*kinds.values()} <= {stat.S_IFREG}


def test_a_command_names_what_it_leaves_in_one_line(tmp_path: Path, home: Path) -> None:
    for kind, plant in KINDS.items():
        plant(tmp_path / f".rig.yaml.lidcam-{kind}", home)
    before = seen(home)
    run = called(tmp_path, "inspect", SANDBOX, "--write-rig", "rig.yaml")
    assert run.code == 0
    assert (tmp_path / "rig.yaml").is_file()
    [line] = [line for line in run.err.splitlines() if "left as it is" in line]
    assert f"{len(KINDS) - 3} more of such names" in line
    assert seen(home) == before


BATCH_PLACES = (
    *(TABLE, RECORDS, f"{RECORDS}/.lock", f"{RECORDS}/day", f"{RECORDS}/day/a.json", f"{RECORDS}/day/a.lock"),
    *("day", "day/a.mcap"),
)


@pytest.mark.parametrize("place", BATCH_PLACES)
def test_a_batch_writes_and_reads_nothing_elsewhere(
    tmp_path: Path, home: Path, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each kind in each place: 104 folders. What is refused is one line of the batch, or of the job."""
    monkeypatch.setattr(os, "fsync", lambda _: None)
    (tmp_path / "logs" / "day").mkdir(parents=True)
    (tmp_path / "logs" / "day" / "a.bag").write_bytes(b"content")
    (tmp_path / "logs" / "b.bag").write_bytes(b"content")
    at_home, outcomes = seen(home), {}
    for kind, plant in KINDS.items():
        out = tmp_path / kind
        (out / place).parent.mkdir(parents=True)
        plant(out / place, home)
        try:
            jobs = find_jobs([str(tmp_path / "logs")], out)
            b, a = run_batch(jobs, BatchOptions(out, Job(())), Written(), lambda _: None)
            Store(out).keep_of_all(TABLE, records_table([a, b]))
            outcomes[kind] = f"{a.state} {b.state}{a.message}"
        except OutputError as err:
            outcomes[kind] = str(err)
        assert seen(home) == at_home, kind
    is_folder = place in {RECORDS, f"{RECORDS}/day", "day"}
    sound = {"empty folder", "folder", "deep folder"} if is_folder else {"file", "hard link", "of another user"}
    for kind, outcome in outcomes.items():
        assert "\n" not in outcome
        if kind == "nothing" or kind in sound:
            assert outcome == "done done", kind
        elif place in {TABLE, RECORDS, f"{RECORDS}/.lock"}:
            assert "expected" in outcome, kind
        else:
            assert outcome.startswith("failed done"), kind
