"""Locks and what killed runs leave: who may take it over, and what is refused."""

import errno
import fcntl
import json
import os
import signal
import threading
from pathlib import Path

import pytest

from pipeline.core.ending import undo_all
from pipeline.core.errors import OutputError
from writers.outputs import exchange as exchanging
from writers.outputs.exchange import Exchange, exchange, identity, read_journal, sync, sync_folder
from writers.outputs.recovery import _close
from writers.outputs.signals import held_signals
from writers.outputs.transaction import OutputTransaction
from writers.outputs.work_folder import BusyError, WorkFolder, Writing, is_work_folder, work_folder_path


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write(path: Path, text: str = "new") -> None:
    with OutputTransaction([path]) as outputs:
        outputs[path].part.write_text(text)


def dead(outputs: list[Path], texts: list[str]) -> None:
    """Leave what a run leaves that is killed while it writes."""
    for output, text in zip(outputs, texts, strict=True):
        folder = WorkFolder(output, output)
        folder.begin(outputs)
        folder.part.write_text(text)
        folder.close(is_done=False)


def in_exchange(outputs: list[Path], texts: list[str]) -> Path:
    """Leave what a run leaves that is killed after it has written the journal; returns the folder with the journal."""
    dead(outputs, texts)
    exchanges = []
    for output in outputs:
        part = work_folder_path(output) / "new" / output.name
        exchanges.append(Exchange(output, identity(output), identity(part)))
    home = work_folder_path(outputs[0])
    exchanging._write_journal(home, exchanges)
    return home


def test_names_of_work_folders(tmp_path: Path) -> None:
    assert work_folder_path(tmp_path / "out.mcap").name == ".out.mcap.lidcam"
    long = {work_folder_path(tmp_path / ("ü" * 120 + letter)).name for letter in "ab"}
    assert len(long) == 2
    assert all(len(name.encode()) < 255 for name in long)
    assert all(is_work_folder(Path(name)) for name in long)
    assert not any(is_work_folder(Path(name)) for name in ("out.mcap", ".lidcam", "x.lidcam"))


@pytest.mark.parametrize("make", [lambda path: path.write_text("mine"), lambda path: path.symlink_to("elsewhere")])
def test_something_else_of_the_folder_s_name_is_not_touched(tmp_path: Path, make: object) -> None:
    path = tmp_path / ".out.mcap.lidcam"
    make(path)  # type: ignore[operator]
    with pytest.raises(OutputError, match=r"out\.mcap: .*\.out\.mcap\.lidcam is in the way"):
        write(tmp_path / "out.mcap")
    assert names_in(tmp_path) == [".out.mcap.lidcam"]


def test_a_folder_of_another_user_is_not_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dead([tmp_path / "out.mcap"], ["half"])
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(OutputError, match="expected a folder of an earlier run of this user"):
        write(tmp_path / "out.mcap")


def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "thesis").write_text("mine")
    dead([tmp_path / "out.mcap"], ["half"])
    lock = tmp_path / ".out.mcap.lidcam" / "lock"
    lock.unlink()
    lock.symlink_to("../thesis")
    with pytest.raises(OutputError, match="cannot be written"):
        write(tmp_path / "out.mcap")
    assert (tmp_path / "thesis").read_text() == "mine"


def test_links_in_a_left_folder_are_removed_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis").write_text("mine")
    dead([tmp_path / "out.mcap"], ["half"])
    new = tmp_path / ".out.mcap.lidcam" / "new"
    (new / "out.mcap").unlink()
    new.rmdir()
    new.symlink_to(tmp_path / "mine")
    write(tmp_path / "out.mcap")
    assert (tmp_path / "mine" / "thesis").read_text() == "mine"
    assert names_in(tmp_path) == ["mine", "out.mcap"]


def test_a_lock_that_was_removed_meanwhile_is_taken_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flock, removed = fcntl.flock, [False]

    def slow(descriptor: int, how: int) -> None:
        if not removed[0]:  # the run that held it ends now
            removed[0] = True
            (tmp_path / ".out.mcap.lidcam" / "lock").unlink()
            (tmp_path / ".out.mcap.lidcam" / "lock").touch()
        flock(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", slow)
    write(tmp_path / "out.mcap")
    assert removed[0]
    assert names_in(tmp_path) == ["out.mcap"]


def test_a_lock_that_is_always_gone_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os.path, "samestat", lambda *_: False)
    with pytest.raises(BusyError, match="is being written by another run"):
        write(tmp_path / "out.mcap")


def test_the_holder_may_not_have_written_its_number_yet(tmp_path: Path) -> None:
    holder = WorkFolder(tmp_path / "out.mcap", tmp_path / "out.mcap")
    with pytest.raises(BusyError, match=r"is being written by another run$"):
        write(tmp_path / "out.mcap")
    (tmp_path / ".out.mcap.lidcam" / "lock").write_text('{"process": 7, "host": "far", "outputs": []}')
    with pytest.raises(BusyError, match=r"another run \(process 7 on far\)"):
        write(tmp_path / "out.mcap")
    holder.close(is_done=True)
    assert names_in(tmp_path) == []


def test_without_locks_the_folder_is_the_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    write(tmp_path / "out.mcap")
    dead([tmp_path / "out.mcap"], ["half"])
    with pytest.raises(OutputError, match="no locks that tell; remove that folder if no run is active"):
        write(tmp_path / "out.mcap")

    def broken(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(fcntl, "flock", broken)
    with pytest.raises(OutputError, match=r"out\.mcap: cannot be written: Input/output error"):
        write(tmp_path / "out.mcap")


def test_without_hard_links_old_outputs_are_moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_links(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    for text in ("first", "second"):
        write(tmp_path / "out.mcap", text)
        assert (tmp_path / "out.mcap").read_text() == text
    rename = Path.rename

    def refusing(self: Path, target: Path) -> Path:
        if self.parent.name == "new":
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refusing)
    with pytest.raises(OutputError, match="Input/output error"):
        write(tmp_path / "out.mcap", "third")
    assert (tmp_path / "out.mcap").read_text() == "second"
    assert names_in(tmp_path) == ["out.mcap"]


def test_where_folders_cannot_be_synced_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(number: int) -> None:
        def fsync(_: int) -> None:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "fsync", fsync)

    (tmp_path / "file").touch()
    refuse(errno.EINVAL)
    sync(tmp_path / "file")
    sync_folder(tmp_path)
    refuse(errno.EIO)
    with pytest.raises(OSError, match="Input/output error"):
        sync(tmp_path / "file")
    with pytest.raises(OSError, match="Input/output error"):
        sync_folder(tmp_path)


def test_what_a_killed_run_left_of_other_outputs_goes_too(tmp_path: Path) -> None:
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    dead([mcap, rrd], ["half", "half"])
    write(rrd)
    assert names_in(tmp_path) == ["out.rrd"]


@pytest.mark.parametrize("is_renamed", [False, True])
def test_a_journal_that_is_not_on_the_disk_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_renamed: bool
) -> None:
    """The next run must not complete what has failed; and what was put back is back, whatever the disk says then."""
    path, fsync, replace = tmp_path / "out.mcap", os.fsync, Path.replace
    path.write_text("old")
    begun: list[Path] = []

    def failing(descriptor: int) -> None:
        if begun:
            raise OSError(errno.EIO, "Input/output error")
        fsync(descriptor)

    def beginning(self: Path, target: Path) -> Path:
        if is_renamed == (target.name == "journal"):
            begun.append(target)
        return replace(self, target)

    def renaming(self: Path, target: Path) -> Path:
        begun.append(target)
        self.replace(target)
        return target

    monkeypatch.setattr(os, "fsync", failing)
    monkeypatch.setattr(Path, "replace", beginning)
    if not is_renamed:
        monkeypatch.setattr(Path, "rename", renaming)
    with pytest.raises(OutputError, match="Input/output error"):
        write(path)
    assert path.read_text() == "old"
    assert names_in(tmp_path) == ["out.mcap"]


def test_an_output_that_cannot_be_kept_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    write(tmp_path / "out.mcap", "old")
    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(OutputError, match="Input/output error"):
        write(tmp_path / "out.mcap")
    assert (tmp_path / "out.mcap").read_text() == "old"
    assert names_in(tmp_path) == ["out.mcap"]


def test_what_another_run_has_is_left_to_it(tmp_path: Path) -> None:
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    dead([mcap, rrd], ["half", "half"])
    other = WorkFolder(mcap, mcap)
    write(rrd)
    assert names_in(tmp_path) == [".out.mcap.lidcam", "out.rrd"]
    other.close(is_done=True)


def test_what_a_later_run_has_is_left_to_it(tmp_path: Path) -> None:
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    dead([mcap, rrd], ["half", "half"])
    with OutputTransaction([mcap]) as outputs:
        dead([mcap.with_name("more.mcap"), rrd], ["half", "half"])
        write(rrd)
        outputs[mcap].part.write_text("new")
    assert names_in(tmp_path) == ["out.mcap", "out.rrd"]


def test_an_exchange_is_completed_by_whoever_comes_next(tmp_path: Path) -> None:
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    mcap.write_text("old")
    in_exchange([mcap, rrd], ["new", "new"])
    with pytest.raises(KeyError), OutputTransaction([rrd]):
        raise KeyError
    assert (mcap.read_text(), rrd.read_text()) == ("new", "new")
    assert names_in(tmp_path) == ["out.mcap", "out.rrd"]


def test_an_exchange_waits_while_another_run_has_one_of_its_outputs(tmp_path: Path) -> None:
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    in_exchange([mcap, rrd], ["new", "new"])
    other = WorkFolder(mcap, mcap)
    with pytest.raises(BusyError):
        write(rrd)
    other.close(is_done=False)
    write(rrd, "newer")
    assert (mcap.read_text(), rrd.read_text()) == ("new", "newer")


def test_a_file_that_appeared_after_the_kill_is_not_replaced(tmp_path: Path) -> None:
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    in_exchange([mcap, rrd], ["new", "new"])
    mcap.write_text("of somebody else")
    with pytest.raises(KeyError), OutputTransaction([mcap]):
        raise KeyError
    assert (mcap.read_text(), rrd.exists()) == ("of somebody else", False)
    assert names_in(tmp_path) == ["out.mcap"]


def test_an_old_file_that_was_removed_after_the_kill_stays_removed(tmp_path: Path) -> None:
    mcap = tmp_path / "out.mcap"
    mcap.write_text("old")
    in_exchange([mcap], ["new"])
    mcap.unlink()
    with pytest.raises(KeyError), OutputTransaction([mcap]):
        raise KeyError
    assert names_in(tmp_path) == []


def test_a_half_undone_exchange_is_undone(tmp_path: Path) -> None:
    mcap, rrd, bag = tmp_path / "out.mcap", tmp_path / "out.rrd", tmp_path / "bag"
    rrd.write_text("old")
    bag.mkdir()
    (bag / "bag.db3").write_text("old")
    dead([mcap, rrd, bag], ["new", "new", "new"])
    work = {path: work_folder_path(path) for path in (mcap, rrd, bag)}
    exchanges = [
        Exchange(mcap, None, identity(work[mcap] / "new" / "out.mcap")),
        Exchange(rrd, identity(rrd), identity(work[rrd] / "new" / "out.rrd")),
        Exchange(bag, identity(bag), None),
    ]
    exchanging._write_journal(work[mcap], exchanges)
    (work[mcap] / "journal").rename(work[mcap] / "undo")
    rrd.rename(work[rrd] / "old" / "out.rrd")
    (work[rrd] / "new" / "out.rrd").rename(rrd)
    bag.rename(work[bag] / "old" / "bag")
    with pytest.raises(KeyError), OutputTransaction([mcap]):
        raise KeyError
    assert (rrd.read_text(), (bag / "bag.db3").read_text()) == ("old", "old")
    assert names_in(tmp_path) == ["bag", "out.rrd"]


def test_what_cannot_be_undone_is_left_to_the_next_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    rename = Path.rename

    def refusing(self: Path, target: Path) -> Path:
        if target in (mcap, work_folder_path(mcap) / "undo"):
            raise OSError(errno.EROFS, "Read-only file system")
        return rename(self, target)

    outputs = OutputTransaction([mcap, rrd]).__enter__()
    for path in (mcap, rrd):
        outputs[path].part.write_text("new")
    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", refusing)
        with pytest.raises(OutputError, match="the next run with this output will"):
            outputs.__exit__(None, None, None)
    assert (mcap.exists(), rrd.read_text()) == (False, "new")
    with pytest.raises(KeyError), OutputTransaction([mcap]):
        raise KeyError
    assert (mcap.read_text(), rrd.read_text()) == ("new", "new")
    assert names_in(tmp_path) == ["out.mcap", "out.rrd"]


@pytest.mark.parametrize("text", ["", "{", "[]", "[1]", '[{"target": 1}]', "[" * 100_000, '{"process": "x"}'])
def test_what_is_no_journal_and_no_note_is_none(tmp_path: Path, text: str) -> None:
    dead([tmp_path / "out.mcap"], ["half"])
    home = tmp_path / ".out.mcap.lidcam"
    for name in ("journal", "lock"):
        (home / name).write_text(text)
    assert read_journal(home) == []
    write(tmp_path / "out.mcap")
    assert names_in(tmp_path) == ["out.mcap"]


def test_the_folders_may_be_moved_in_between(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    in_exchange([tmp_path / "a" / "out.mcap", tmp_path / "a" / "out.rrd"], ["new", "new"])
    assert json.loads((tmp_path / "a" / ".out.mcap.lidcam" / "journal").read_text())[1]["target"] == "out.rrd"
    (tmp_path / "a").rename(tmp_path / "b")
    write(tmp_path / "b" / "out.mcap", "newer")
    assert (tmp_path / "b" / "out.rrd").read_text() == "new"
    assert names_in(tmp_path / "b") == ["out.mcap", "out.rrd"]


def test_signals_wait_and_then_act() -> None:
    came = []
    before = signal.signal(signal.SIGTERM, lambda *_: came.append("acted"))
    try:
        with held_signals():
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
            assert came == []
        assert came == ["acted"]
        thread = threading.Thread(target=held_signals().__enter__)
        thread.start()
        thread.join()
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("name", ["mkdir", "replace", "rename"])
def test_a_signal_in_a_step_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    real = getattr(Path, name)

    def interrupted(self: Path, *arguments: object, **options: object) -> object:
        os.kill(os.getpid(), signal.SIGINT)
        return real(self, *arguments, **options)

    monkeypatch.setattr(Path, name, interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            write(tmp_path / "out.mcap")
    finally:
        signal.signal(signal.SIGINT, before)
    assert names_in(tmp_path) == ([] if name == "mkdir" else ["out.mcap"])


def test_an_exchange_with_nothing_to_rename_is_done(tmp_path: Path) -> None:
    home = work_folder_path(tmp_path / "out.mcap")
    home.mkdir()
    exchange(home, [Exchange(tmp_path / "out.mcap", None, None)])
    assert names_in(home) == []


def test_a_folder_that_appears_again_while_it_is_locked_is_removed(tmp_path: Path) -> None:
    """The other work folder of a dead run may go between the look and the lock; then there is a new, empty one."""
    home = WorkFolder(tmp_path / "out.mcap", tmp_path / "out.mcap")
    _close(WorkFolder(tmp_path / "out.rrd", tmp_path / "out.rrd"), Writing(1, "", ()), home.path)
    home.close(is_done=True)
    assert names_in(tmp_path) == []


def test_an_old_second_name_is_replaced(tmp_path: Path) -> None:
    """A run that was killed after it had kept the old output keeps it again."""
    mcap, rrd = tmp_path / "out.mcap", tmp_path / "out.rrd"
    mcap.write_text("old")
    home = in_exchange([mcap, rrd], ["new", "new"])
    os.link(mcap, home / "old" / "out.mcap")
    with pytest.raises(KeyError), OutputTransaction([mcap]):
        raise KeyError
    assert (mcap.read_text(), rrd.read_text()) == ("new", "new")


def test_a_work_folder_that_cannot_have_a_lock_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.open

    def no_files(path: Path, flags: int, *more: int) -> int:
        if flags & os.O_CREAT:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, flags, *more)

    monkeypatch.setattr(os, "open", no_files)
    with pytest.raises(OutputError, match=r"out\.mcap: cannot be written: No space left on device"):
        write(tmp_path / "out.mcap")
    assert names_in(tmp_path) == []
    dead_folder = tmp_path / ".out.mcap.lidcam"
    dead_folder.mkdir()
    with pytest.raises(OutputError, match="No space left on device"):
        write(tmp_path / "out.mcap")
    assert names_in(tmp_path) == [".out.mcap.lidcam"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
@pytest.mark.parametrize("mode", [0o000, 0o500, 0o600])
def test_a_closed_folder_is_one_line(tmp_path: Path, mode: int) -> None:
    folder = tmp_path / "closed"
    folder.mkdir(mode=mode)
    try:
        with pytest.raises(OutputError, match=r"out\.mcap: cannot be written: Permission denied"):
            write(folder / "out.mcap")
    finally:
        folder.chmod(0o700)
    assert names_in(folder) == []


def test_what_ends_the_process_at_once_discards_the_outputs_until_they_get_their_names(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    outputs = OutputTransaction([path]).__enter__()
    with outputs._committing:
        undo_all()
    assert names_in(tmp_path) == [".out.mcap.lidcam"]
    outputs.__exit__(KeyError, None, None)
    assert names_in(tmp_path) == []
    outputs = OutputTransaction([path]).__enter__()
    undo_all()
    assert names_in(tmp_path) == []
    outputs._committing.release()
    outputs.__exit__(KeyError, None, None)
