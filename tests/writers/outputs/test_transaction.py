"""Outputs appear together or not at all, whatever ends the run."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from pipeline.core.errors import OutputError
from writers.outputs.transaction import OutputTransaction

ROOT = Path(__file__).resolve().parents[3]


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


def test_no_outputs() -> None:
    write([])


def test_a_part_of_someone_else_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "out.mcap.part").write_text("mine")
    write([tmp_path / "out.mcap"])
    assert (tmp_path / "out.mcap.part").read_text() == "mine"


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("older")
    (tmp_path / "link").symlink_to("file")
    write([tmp_path / "link"])
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "whole"
    assert names_in(tmp_path) == ["file", "link"]


def make_fifo(folder: Path) -> Path:
    os.mkfifo(folder / "pipe")
    return folder / "pipe"


def make_link(folder: Path) -> Path:
    (folder / "link").symlink_to("nowhere/file")
    return folder / "link"


def make_loop(folder: Path) -> Path:
    (folder / "loop").symlink_to("loop")
    return folder / "loop"


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda folder: folder / "no" / "out.mcap", "the folder .* does not exist; create it"),
        (lambda folder: folder, "found a folder"),
        (make_fifo, "not a regular file"),
        (lambda _: Path("/dev/full"), "not a regular file"),
        (make_link, "is a link to nowhere/file, which does not exist"),
        (make_loop, "is a link to loop, which does not exist"),
        (lambda folder: make_loop(folder) / "out.mcap", "expected the name of a file|cannot be written|not exist"),
        (lambda folder: folder / ("x" * 300), "cannot be written: File name too long"),
        (lambda folder: folder / "a\0b", "expected the name of a file to write"),
        (lambda _: Path("/proc/out.mcap"), "cannot be written"),
    ],
    ids=["missing folder", "folder", "fifo", "device", "broken link", "loop", "in a loop", "too long", "null", "/proc"],
)
def test_an_unusable_name_is_one_clear_line(tmp_path: Path, make: Callable[[Path], Path], expected: str) -> None:
    path = make(tmp_path)
    before = names_in(tmp_path)
    with pytest.raises(OutputError, match=expected) as caught, OutputTransaction([tmp_path / "other.rrd", path]):
        pytest.fail("the block must not run")
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == before


@pytest.mark.parametrize("name", [b"\xff\xfe.mcap", b"a\nb.mcap", b"x" * 255, "ü".encode() * 127, b" ", b"-", b".x"])
def test_odd_names_are_names(tmp_path: Path, name: bytes) -> None:
    path = tmp_path / os.fsdecode(name)
    write([path])
    write([path], "again")
    assert path.read_text() == "again"
    assert names_in(tmp_path) == [os.fsdecode(name)]


def test_one_file_by_two_names_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out.rrd").symlink_to("out.mcap")
    (tmp_path / "out.mcap").write_text("older")
    with pytest.raises(OutputError, match=r"out\.rrd: is the same file as .*out\.mcap; choose another name"):
        write([tmp_path / "out.mcap", tmp_path / "out.rrd"])
    assert names_in(tmp_path) == ["out.mcap", "out.rrd"]


@pytest.mark.parametrize(
    ("output", "beside"), [("out.mcap", "out.foxglove.json"), ("x.bag", "x.bag.rig.yaml"), ("out.rrd", "out.mcap")]
)
def test_a_refusal_names_the_output_not_what_is_written_beside_it(tmp_path: Path, output: str, beside: str) -> None:
    paths = [tmp_path / output, tmp_path / beside]
    with (
        OutputTransaction(paths),
        pytest.raises(OutputError, match=rf"{output}: is being written by another run"),
        OutputTransaction(paths[::-1]),
    ):
        pass


def test_a_second_run_with_an_output_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "link").symlink_to(tmp_path)
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    with OutputTransaction([mcap, rrd]) as outputs:
        for path in (mcap, rrd, tmp_path / "sub" / ".." / "out.mcap", tmp_path / "link" / "out.rrd"):
            expected = rf"{path.name}: is being written by another run \(process {os.getpid()}\)"
            with pytest.raises(OutputError, match=expected):
                write([tmp_path / "another.mcap", path])
        outputs[mcap].part.write_text("first")
        outputs[rrd].part.write_text("first")
    assert texts([mcap, rrd]) == ["first"] * 2
    assert names_in(tmp_path) == ["link", "out.mcap", "out.rrd", "sub"]


def test_old_outputs_may_have_to_stay(tmp_path: Path) -> None:
    def refuse(path: Path) -> None:
        raise OutputError(f"{path.name}: stays")

    (tmp_path / "out.rrd").write_text("older")
    with (
        pytest.raises(OutputError, match=r"out\.rrd: stays"),
        OutputTransaction([tmp_path / "out.mcap", tmp_path / "out.rrd"], check_old=refuse),
    ):
        pytest.fail("the block must not run")
    assert names_in(tmp_path) == ["out.rrd"]

    def meanwhile() -> None:
        with OutputTransaction([tmp_path / "out.mcap"], check_old=refuse) as outputs:
            outputs[tmp_path / "out.mcap"].part.write_text("new")
            (tmp_path / "out.mcap").write_text("of someone else, meanwhile")

    with pytest.raises(OutputError, match=r"out\.mcap: stays"):
        meanwhile()
    assert (tmp_path / "out.mcap").read_text() == "of someone else, meanwhile"
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


def test_a_folder_is_exchanged_as_a_whole(tmp_path: Path) -> None:
    bag, beside = tmp_path / "bag", tmp_path / "bag.rig.yaml"
    for text in ("first", "second"):
        with OutputTransaction([bag, beside], folders=[bag]) as outputs:
            outputs[bag].part.mkdir()
            (outputs[bag].part / "bag.db3").write_text(text)
            outputs[beside].part.write_text(text)
            if text == "second":
                assert (bag / "bag.db3").read_text() == "first"
        assert texts([bag / "bag.db3", beside]) == [text] * 2
        assert names_in(tmp_path) == ["bag", "bag.rig.yaml"]
    with pytest.raises(OutputError, match="expected the name of a folder to write, found a file"):
        OutputTransaction([beside], folders=[beside]).__enter__()


def test_a_folder_that_vanishes_is_one_line(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()

    def vanish() -> None:
        with OutputTransaction([folder / "out.mcap"]) as outputs:
            outputs[folder / "out.mcap"].part.write_text("whole")
            subprocess.run(["rm", "-r", folder], check=True)

    with pytest.raises(OutputError, match=r"out\.mcap: cannot be written: No such file"):
        vanish()
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("refused", [0, 1, 2])
@pytest.mark.parametrize("old", [0, 1, 3])
def test_a_refused_rename_undoes_those_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: int, old: int
) -> None:
    paths = three(tmp_path)
    for path in paths[:old]:
        path.write_text("older")
    rename = Path.rename
    asked: list[Path] = []

    def refusing(self: Path, target: Path) -> Path:
        asked.append(target)
        if target == paths[refused] and asked.count(target) == 1:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refusing)
    with pytest.raises(OutputError, match=r"out\.mcap: cannot be written: Input/output error"):
        write(paths, "new")
    assert texts(paths[:old]) == ["older"] * old
    assert names_in(tmp_path) == sorted(path.name for path in paths[:old])
    write(paths, "newer")
    assert texts(paths) == ["newer"] * 3


KILLED = """
import os, sys
from pathlib import Path
sys.path.insert(0, {root!r})
from writers.outputs import exchange
from writers.outputs.transaction import OutputTransaction

def killing(name, left):
    real = getattr(Path, name)
    def call(self, *arguments, **options):
        if left[0] == 0:
            os.kill(os.getpid(), 9)
        left[0] -= 1
        return real(self, *arguments, **options)
    setattr(Path, name, call)

os.fsync = lambda _: None

def run(step, folder):
    left = [step]
    for name in ("rename", "replace", "unlink", "rmdir", "mkdir", "chmod"):
        killing(name, left)
    paths = [Path(folder, name) for name in sys.argv[1].split()]
    with OutputTransaction(paths) as outputs:
        for path in paths:
            outputs[path].part.write_text("new")

for step, folder in enumerate(sys.argv[2:]):
    pid = os.fork()
    if not pid:
        code = 1
        try:
            run(step, folder)
            code = 0
        finally:
            os._exit(code)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
"""
MAX_STEPS = 60


@pytest.mark.parametrize("old", [0, 3])
def test_a_run_killed_at_any_step_leaves_all_or_none_to_the_next(
    tmp_path: Path, old: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the kill the main output is old, or all are new; after a run that fails, all are old or all are new."""
    monkeypatch.setattr(os, "fsync", lambda _: None)  # a disk is slow, and a kill loses nothing of what it has
    folders = [tmp_path / str(step) for step in range(MAX_STEPS)]
    for folder in folders:
        folder.mkdir()
        for path in three(folder)[:old]:
            path.write_text("older")
    names = " ".join(path.name for path in three(tmp_path))
    command: list[str | Path] = [sys.executable, "-S", "-c", KILLED.format(root=str(ROOT)), names, *folders]
    codes = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert len(codes) == MAX_STEPS
    steps = codes.index("0")
    assert 10 < steps < MAX_STEPS
    assert set(codes[:steps]) == {"-9"}
    assert set(codes[steps:]) == {"0"}
    for step, folder in enumerate(folders[: steps + 1]):
        paths = three(folder)
        if paths[0].exists() and paths[0].read_text() == "new":
            assert texts(paths) == ["new"] * 3
        with pytest.raises(ValueError, match="next"):
            write(paths[: 1 + step % 3][::-1], "half", ValueError("next"))
        found = [path.read_text() if path.exists() else None for path in paths]
        assert found in ([None if not old else "older"] * 3, ["new"] * 3)
        with pytest.raises(ValueError, match="next"):
            write(paths, "half", ValueError("next"))
        assert found == [path.read_text() if path.exists() else None for path in paths]
        assert names_in(folder) == sorted(path.name for path in paths if path.exists())
