"""Exchanging old outputs for new ones: all of them or none, also when the process is killed in between.

The journal is written when all new outputs are whole and on the disk. From then on every state of the folders says what
is left to do: an output that still lies in its work folder has not got its name. So whoever finds the journal can go
on, and its name, `journal` or `undo`, says in which direction.
"""

import contextlib
import errno
import json
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pipeline.core.errors import OutputError
from writers.outputs.work_folder import remove, work_folder_path

__all__ = ["Exchange", "exchange", "has_journal", "identity", "read_journal", "resume", "sync", "sync_folder"]

_JOURNAL, _UNDO, _UNFINISHED = "journal", "undo", "journal.new"

_MAX_JOURNAL_BYTES = 1 << 20
_NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EXDEV}
_CANNOT_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}
"""Answers of file systems that have no fsync of a folder."""


class Exchange(NamedTuple):
    """One output whose new version takes the place of the old one.

    Attributes:
        target: The output, without links.
        old: Identity of what stood there; None: nothing.
        new: Identity of what takes its place.
    """

    target: Path
    old: str | None
    new: str | None

    @property
    def part(self) -> Path:
        """Where the new version lies until it gets its name."""
        return work_folder_path(self.target) / "new" / self.target.name

    @property
    def kept(self) -> Path:
        """Where the old version is kept."""
        return work_folder_path(self.target) / "old" / self.target.name


def identity(path: Path) -> str | None:
    """What tells a file or folder from another one of the same name; None: nothing stands there.

    Size and time of change; not the inode, which some file systems number anew.

    Raises:
        OSError: it cannot be looked at.
    """
    try:
        found = os.lstat(path)
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(found.st_mode):
        inside = [(entry.name, entry.stat(follow_symlinks=False)) for entry in os.scandir(path)]
        return json.dumps(sorted((name, one.st_size, one.st_mtime_ns) for name, one in inside))
    return json.dumps([stat.S_IFMT(found.st_mode), found.st_size, found.st_mtime_ns])


def sync(path: Path) -> None:
    """Wait until a file, or a folder with all that is in it, is on the disk.

    Raises:
        OSError: the disk refuses.
    """
    if path.is_dir() and not path.is_symlink():
        for entry in path.iterdir():
            sync(entry)
        sync_folder(path)
        return
    _sync_descriptor(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC))


def exchange(home: Path, exchanges: Sequence[Exchange]) -> None:
    """Give all new outputs their names; if the system refuses one of them, all old ones are put back.

    Args:
        home: The work folder of the first output; gets the journal.
        exchanges: The outputs, in the order of importance: the first gets its name last.

    Raises:
        OSError: the system refused, and everything is as it was.
        OutputError: it refused that, too; the journal stays.
    """
    try:
        _write_journal(home, exchanges)
    except OSError:
        with contextlib.suppress(OSError):  # else the next run would complete what has failed
            (home / _JOURNAL).unlink()
        raise
    _go_on(home, exchanges)


def resume(home: Path, exchanges: Sequence[Exchange]) -> None:
    """Go on with the exchange of a run that was killed.

    Raises:
        OSError: the system refused, and everything is as it was.
        OutputError: it refused that, too; the journal stays.
    """
    if os.path.lexists(home / _UNDO):
        _take_back(exchanges)
        (home / _UNDO).unlink()
    else:
        _go_on(home, exchanges)


def has_journal(home: Path) -> bool:
    """Whether an exchange is under way, or was when its run was killed."""
    return os.path.lexists(home / _JOURNAL) or os.path.lexists(home / _UNDO)


def read_journal(home: Path) -> list[Exchange]:
    """The exchanges of a journal; none if there is no journal, or it is not one.

    Raises:
        OSError: it cannot be read.
    """
    for name in (_UNDO, _JOURNAL):
        with contextlib.suppress(FileNotFoundError):
            descriptor = os.open(home / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            with os.fdopen(descriptor, "rb") as file:
                text = file.read(_MAX_JOURNAL_BYTES)
            with contextlib.suppress(ValueError, TypeError, KeyError, RecursionError):
                return [
                    Exchange(Path(os.path.normpath(home.parent / row["target"])), row["old"], row["new"])
                    for row in json.loads(text)
                ]
    return []


def _write_journal(home: Path, exchanges: Sequence[Exchange]) -> None:
    # Relative: the folders may be moved, or be mounted elsewhere.
    rows = [{"target": os.path.relpath(one.target, home.parent), "old": one.old, "new": one.new} for one in exchanges]
    written = home / _UNFINISHED
    with written.open("w", encoding="utf-8") as file:
        json.dump(rows, file)
        file.flush()
        os.fsync(file.fileno())
    written.replace(home / _JOURNAL)
    sync_folder(home)


def _go_on(home: Path, exchanges: Sequence[Exchange]) -> None:
    try:
        _complete(exchanges)
    except OSError as refused:
        try:
            (home / _JOURNAL).rename(home / _UNDO)
            _take_back(exchanges)
            (home / _UNDO).unlink()
        except OSError as err:
            raise OutputError(
                f"{exchanges[0].target}: cannot be written: {refused.strerror}; some of the outputs have their names "
                f"and the system refuses to undo it ({err.strerror}): the next run with this output will, by {home}"
            ) from err
        raise
    with contextlib.suppress(OSError):  # all is done; a journal that stays finds nothing to do
        (home / _JOURNAL).unlink()


def _complete(exchanges: Sequence[Exchange]) -> None:
    """Give every new output its name, the first one last; what has been done is not done again.

    Raises:
        OSError: the system refuses, or something else has taken the place of an output.
    """
    for one in reversed(exchanges):
        if not os.path.lexists(one.part):
            continue
        found = identity(one.target)
        if found is None:
            if one.old is not None and not os.path.lexists(one.kept):
                raise FileNotFoundError(errno.ENOENT, "the old file has been removed meanwhile", str(one.target))
        elif found != one.old:
            raise FileExistsError(errno.EEXIST, "another file has appeared meanwhile", str(one.target))
        else:
            _keep(one)
        one.part.rename(one.target)
    for folder in dict.fromkeys(one.target.parent for one in exchanges):
        sync_folder(folder)


def _take_back(exchanges: Sequence[Exchange]) -> None:
    """Put every old output back; what has been done is not done again.

    Raises:
        OSError: the system refuses.
    """
    for one in exchanges:
        is_new = not os.path.lexists(one.part) and one.new is not None and identity(one.target) == one.new
        is_kept = os.path.lexists(one.kept)
        if is_new and (not is_kept or one.target.is_dir()):
            one.target.rename(one.part)
        if is_kept and (is_new or not os.path.lexists(one.target)):
            one.kept.replace(one.target)
    for folder in dict.fromkeys(one.target.parent for one in exchanges):
        with contextlib.suppress(OSError):  # all is back; a disk that refuses this is asked for nothing else
            sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk; not what they stand for.

    Raises:
        OSError: the disk refuses.
    """
    _sync_descriptor(os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC))


def _sync_descriptor(descriptor: int) -> None:
    """Wait for the disk, and close the descriptor."""
    try:
        os.fsync(descriptor)
    except OSError as err:
        if err.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)


def _keep(one: Exchange) -> None:
    """Keep the old output: a file under a second name, so that it stands until the new one takes its place."""
    if not one.target.is_dir():
        try:
            os.link(one.target, one.kept, follow_symlinks=False)
        except FileExistsError:
            with contextlib.suppress(FileNotFoundError):
                remove(one.kept)
            os.link(one.target, one.kept, follow_symlinks=False)
        except OSError as err:
            if err.errno not in _NO_LINKS:
                raise
        else:
            return
    one.target.rename(one.kept)
