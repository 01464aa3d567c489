"""Outputs appear together or not at all, whatever ends the run."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import Mock

import pytest
from helpers import ROOT

from lidcam.pipeline.core.errors import OutputError
from lidcam.writers.outputs.transaction import OutputTransaction


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write(paths: Sequence[Path], text: str = "whole", error: BaseException | None = None) -> None:
    with OutputTransaction(paths) as outputs:
        for path in paths:
            outputs[path].part.write_text(text)
        if error is not None:
            raise error


def three(folder: Path) -> list[Path]:
    return [folder / name for name in ("out.mcap", "out.rrd", "out.foxglove.json")]


def texts(paths: Sequence[Path]) -> list[str]:
    return [path.read_text() for path in paths]


def test_outputs_appear_when_the_block_ends(tmp_path: Path) -> None:
    paths = three(tmp_path)
    with OutputTransaction(paths) as outputs:
        for path in paths:
            outputs[path].part.write_text("whole")
            assert outputs[path].path == path
        assert not any(path.exists() for path in paths)
    assert texts(paths) == ["whole"] * 3
    assert names_in(tmp_path) == sorted(path.name for path in paths)


@pytest.mark.parametrize("error", [ValueError(), KeyboardInterrupt(), SystemExit()])
def test_a_failure_leaves_the_older_files_and_nothing_else(tmp_path: Path, error: BaseException) -> None:
    paths = three(tmp_path)
    write(paths[:2], "older")
    with pytest.raises(type(error)):
        write(paths, "half", error)
    assert texts(paths[:2]) == ["older"] * 2
    assert names_in(tmp_path) == ["out.mcap", "out.rrd"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("file/no/out.mcap", "cannot be written: Not a directory"),
        (".", "found a folder"),
        ("pipe", "expected the name of a file to write, found a device or a pipe"),
        ("link", "found a link; name what it points to"),
        ("x" * 250, "cannot be written: File name too long"),
        ("a\0b", "expected the name of a file to write"),
        ("/proc/out.mcap", "cannot be written"),
        ("https://host/out.mcap", "expected the name of a file to write on this machine, found a URL"),
    ],
    ids=["in a file", "folder", "fifo", "link", "too long", "null", "/proc", "URL"],
)
def test_an_unusable_name_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("file").touch()
    Path("link").symlink_to("nowhere/file")
    before = names_in(tmp_path)
    with pytest.raises(OutputError, match=expected) as caught, OutputTransaction([tmp_path / "other.rrd", Path(name)]):
        pytest.fail("the block must not run")
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == before


def test_missing_folders_are_made_and_a_failure_leaves_none(tmp_path: Path) -> None:
    paths = [tmp_path / "a" / "b" / "out.mcap", tmp_path / "a" / "b" / "out.rrd", tmp_path / "a" / "c" / "out.csv"]
    with pytest.raises(ValueError, match="half"):
        write(paths, "half", ValueError("half"))
    with pytest.raises(OutputError, match="too long"):
        write([*paths, tmp_path / "d" / ("x" * 250)])
    assert names_in(tmp_path) == []
    write(paths)
    assert names_in(tmp_path / "a") == ["b", "c"]
    assert names_in(tmp_path / "a" / "b") == ["out.mcap", "out.rrd"]


@pytest.mark.parametrize("name", [b"\xff\xfe.mcap", b"a\nb.mcap", b"[*].mcap", b" "])
def test_odd_names_are_names(tmp_path: Path, name: bytes) -> None:
    path = tmp_path / os.fsdecode(name)
    write([path])
    write([path], "again")
    assert path.read_text() == "again"
    assert names_in(tmp_path) == [os.fsdecode(name)]


def test_one_file_by_two_names_is_refused(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path)
    with pytest.raises(OutputError, match=r"link/out\.mcap: is the same file as .*out\.mcap; choose another name"):
        write([tmp_path / "out.mcap", tmp_path / "link" / "out.mcap"])
    assert names_in(tmp_path) == ["link"]


def test_a_second_run_with_an_output_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "link").symlink_to(tmp_path)
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    with OutputTransaction([mcap, rrd]) as outputs:
        for path in (mcap, rrd, tmp_path / "sub" / ".." / "out.mcap", tmp_path / "link" / "out.rrd"):
            expected = rf"{path.name}: is being written by another run"
            with pytest.raises(OutputError, match=expected):
                write([tmp_path / "another.mcap", path])
        outputs[mcap].part.write_text("first")
        outputs[rrd].part.write_text("first")
    assert texts([mcap, rrd]) == ["first"] * 2
    assert names_in(tmp_path) == ["link", "out.mcap", "out.rrd", "sub"]


def test_old_outputs_may_have_to_stay(tmp_path: Path) -> None:
    def refuse(path: Path) -> None:
        raise OutputError(f"{path.name}: stays")

    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    rrd.write_text("older")
    with pytest.raises(OutputError, match=r"out\.rrd: stays"), OutputTransaction([mcap, rrd], check_old=refuse):
        pytest.fail("the block must not run")
    assert names_in(tmp_path) == ["out.rrd"]

    def meanwhile() -> None:
        with OutputTransaction([mcap], check_old=refuse) as outputs:
            outputs[mcap].part.write_text("new")
            mcap.write_text("of someone else, meanwhile")

    with pytest.raises(OutputError, match=r"out\.mcap: stays"):
        meanwhile()
    assert mcap.read_text() == "of someone else, meanwhile"
    assert names_in(tmp_path) == ["out.mcap", "out.rrd"]


def test_permissions_are_those_of_the_umask_or_of_the_old_file(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write([tmp_path / "new"])
        (tmp_path / "old").write_text("older")
        (tmp_path / "old").chmod(0o606)
        write([tmp_path / "old"])
    finally:
        os.umask(before)
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in ("new", "old")] == [0o640, 0o606]


def write_folder(bag: Path, text: str, *beside: Path) -> None:
    with OutputTransaction([bag, *beside], folders=[bag]) as outputs:
        outputs[bag].part.mkdir()
        (outputs[bag].part / "bag.db3").write_text(text)
        for path in beside:
            outputs[path].part.write_text(text)
        assert not bag.exists() or (bag / "bag.db3").read_text() != text


def test_a_folder_is_exchanged_as_a_whole(tmp_path: Path) -> None:
    bag, beside = tmp_path / "bag", tmp_path / "bag.rig.yaml"
    for text in ("first", "second"):
        write_folder(bag, text, beside)
        assert texts([bag / "bag.db3", beside]) == [text] * 2
        assert names_in(tmp_path) == ["bag", "bag.rig.yaml"]
    with pytest.raises(OutputError, match="expected the name of a folder to write, found a file"):
        OutputTransaction([beside], folders=[beside]).__enter__()


def refuse_renames(monkeypatch: pytest.MonkeyPatch, of_name: str) -> None:
    """Refuse what renames the output of a name out of a work folder."""
    rename = Path.rename

    def refuse(path: Path, to: Path) -> Path:
        if path.name == to.name == of_name:  # not the way back of NAME.old
            raise OSError(5, "Input/output error")
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", refuse)


@pytest.mark.parametrize("refused", [0, 1, 2])
def test_a_refused_rename_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: int) -> None:
    paths = three(tmp_path)
    write(paths, "older")
    refuse_renames(monkeypatch, paths[refused].name)
    with pytest.raises(OutputError, match=rf"{paths[refused].name}: cannot be written: Input/output error"):
        write(paths, "whole")
    assert texts(paths) == ["older"] * (refused + 1) + ["whole"] * (2 - refused)
    assert names_in(tmp_path) == sorted(path.name for path in paths)


@pytest.mark.parametrize("name", ["bag", "lock", "old"])
def test_an_old_folder_is_back_when_the_new_one_is_refused_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    write_folder(tmp_path / name, "first")
    write_folder(tmp_path / name, "older")
    refuse_renames(monkeypatch, name)
    with pytest.raises(OutputError, match=rf"{name}: cannot be written: Input/output error"):
        write_folder(tmp_path / name, "new")
    assert (tmp_path / name / "bag.db3").read_text() == "older"
    assert names_in(tmp_path) == [name]


KILLED = """
import os, signal, sys
from pathlib import Path
from lidcam.writers.outputs.transaction import OutputTransaction

step, folder = int(sys.argv[1]), Path(sys.argv[2])
paths = [folder / name for name in ("out.mcap", "out.rrd", "out.foxglove.json")]
done = 0

def killing(function):
    def one(*arguments, **named):
        global done
        done += 1
        if done == step:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **named)
    return one

for name in ("fsync", "mkdir", "rename", "replace"):
    setattr(os, name, killing(getattr(os, name)))
with OutputTransaction(paths) as outputs:
    for path in paths:
        outputs[path].part.write_text("new")
sys.exit(done)
"""


def killed(step: int, folder: Path) -> int:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, "-c", KILLED, str(step), str(folder)], env=environment).returncode


def test_a_run_killed_at_any_step_leaves_whole_files_and_the_next_one_cleans_up(tmp_path: Path) -> None:
    steps = killed(0, tmp_path)
    assert steps > 8
    for step in range(1, steps + 1):
        write(three(tmp_path), "older")
        assert killed(step, tmp_path) == -9
        found = texts(three(tmp_path))
        assert found in (["older"] * 3, ["older", "older", "new"], ["older", "new", "new"], ["new"] * 3)
        write(three(tmp_path), "next")
        assert texts(three(tmp_path)) == ["next"] * 3
        assert len(names_in(tmp_path)) == 3


def test_a_file_system_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two runs may write one output: the last of them wins, and the file is whole."""
    monkeypatch.setattr("fcntl.flock", Mock(side_effect=OSError(37, "No locks available")))
    path = tmp_path / "out.mcap"
    with OutputTransaction([path]) as outputs:
        outputs[path].part.write_text("last")
        write([path], "first")
    assert (path.read_text(), names_in(tmp_path)) == ("last", ["out.mcap"])
