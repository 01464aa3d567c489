"""Temporary folders: gone with their run, or with the next one."""

import errno
import fcntl
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from lidcam.readers.files.temporary import PREFIX, remove_abandoned, temporary_folder

CHILD = """
import sys, time
from lidcam.readers.files.temporary import temporary_folder
with temporary_folder() as folder:
    (folder / "unpacked.bag").touch()
    print(folder, flush=True)
    time.sleep(3600)  # until it is killed
"""


@pytest.fixture(autouse=True)
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def abandoned(base: Path, name: str = f"{PREFIX}abcd_123") -> Path:
    folder = base / name
    folder.mkdir(0o700)
    (folder / "unpacked.bag").touch()
    os.utime(folder, (1, 1))
    return folder


def test_it_goes_with_the_block(base: Path) -> None:
    with temporary_folder() as folder:
        assert folder.parent == base
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "unpacked.bag").touch()
        remove_abandoned()
        assert [path.name for path in folder.iterdir()] == ["unpacked.bag"]
    assert list(base.iterdir()) == []


def test_it_stays_with_its_run_and_goes_after_that_was_killed(base: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(base)}
    with subprocess.Popen([sys.executable, "-c", CHILD], stdout=subprocess.PIPE, text=True, env=environment) as run:
        assert run.stdout is not None
        folder = Path(run.stdout.readline().strip())
        os.utime(folder, (1, 1))
        remove_abandoned()
        assert (folder / "unpacked.bag").exists()
        run.kill()
    assert (folder / "unpacked.bag").exists()
    remove_abandoned()
    assert list(base.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["lidcam-notes", f"{PREFIX}of_mine", f"{PREFIX}abcd_1234", f"x{PREFIX}abcd_123", "abcd"]
)
def test_folders_of_other_names_stay(base: Path, name: str) -> None:
    abandoned(base, name)
    remove_abandoned()
    assert (base / name / "unpacked.bag").exists()


def _link(folder: Path) -> None:
    shutil.move(folder, folder.with_name("elsewhere"))
    folder.symlink_to(folder.with_name("elsewhere"))


def _link_inside(folder: Path) -> None:
    outside = folder.with_name("outside")
    outside.mkdir()
    (outside / "kept").touch()
    (folder / "link").symlink_to(outside)


def _file(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.touch()


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        (_link, "elsewhere/unpacked.bag"),
        (_link_inside, "outside/kept"),
        (_file, f"{PREFIX}abcd_123"),
        (lambda folder: folder.chmod(0o755), f"{PREFIX}abcd_123/unpacked.bag"),
        (os.utime, f"{PREFIX}abcd_123/unpacked.bag"),  # young
    ],
)
def test_only_what_a_run_made_is_removed(change: Callable[[Path], None], kept: str, base: Path) -> None:
    change(abandoned(base))
    remove_abandoned()
    assert (base / kept).exists()


def test_those_of_other_users_stay(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = abandoned(base)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    remove_abandoned()
    assert (folder / "unpacked.bag").exists()


def test_a_file_system_without_locks(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> None:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    kept = abandoned(base)
    with temporary_folder() as folder:
        remove_abandoned()
        assert folder.is_dir()
    assert list(base.iterdir()) == [kept]
