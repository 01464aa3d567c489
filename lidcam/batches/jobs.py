"""The recordings of a batch: files, folders with their subfolders, patterns, and lists."""

import glob
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path, PurePath
from typing import TypeVar
from unicodedata import category

from lidcam.outputs.bucket import Bucket, is_bucket
from lidcam.pipeline.core.errors import LidcamError, RecordingError
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.pipeline.core.text import visible
from lidcam.readers.location import ENDINGS, Location, RemotePath, location, recording_stem
from lidcam.readers.natural_order import natural_key
from lidcam.readers.open import open_recording

METADATA = "metadata.yaml"
"""File in the folder of a ROS 2 bag, which is one recording."""

PART = re.compile(r"(.+)_(\d+)")
"""Name of a part of a split recording, without ending."""

MAX_PAUSE_NS = 5_000_000_000
"""Longest pause between the parts of a split recording."""

MAX_OVERLAP_NS = 1_000_000_000
"""Longest time that two parts of a split recording share."""

MAX_LIST_BYTES = 16 << 20

RECORDS = ".lidcam-batch"
"""Folder of the records of a batch, in that of the results."""

TABLE_STEM = "_jobs"
"""Name of the table of a batch, without ending, in the folder of the results."""

MAX_NAME_BYTES = 200
"""Maximum length of a name: files take 255 bytes, and what is written beside a result has a longer name."""

INDEX = "index.html"
"""Page of a batch, in the folder of the results."""

OTHER_FOLDER = "expected another folder for the results: the next batch would take them for recordings"
NONE_FOUND = f"expected recordings ({', '.join(ENDINGS)}) in it, found none"

L = TypeVar("L", Path, RemotePath)


@dataclass(frozen=True, slots=True)
class BatchJob:
    """One recording of a batch."""

    inputs: tuple[Location, ...]  # The recording, or all parts of a split one in order
    name: str  # Name of its results, without ending, below the folder of the batch: `day1/drive`
    bytes: int  # Size of the files; 0 if unknown
    fault: str = ""  # Reason why no result can have this name; empty: there is none

    @property
    def shown_inputs(self) -> str:
        """The recording as valid UTF-8, without credentials."""
        return ", ".join(map(str, self.inputs)).encode(errors="backslashreplace").decode()


def find_jobs(given: Sequence[str], out: Location) -> list[BatchJob]:
    """One job per recording, ordered by name.

    Given are recordings, folders (also `s3://bucket/logs`), patterns (`'logs/*.bag'`), URLs, and `@list.txt` with one
    of these per line. The folder of the results, `out`, is not searched. Raises RecordingError if there are none, an
    input does not exist, a folder holds no recording or cannot be listed, or two results would have the same name.
    """
    jobs: list[BatchJob] = []
    try:
        for text in _listed(given, out):
            jobs += _of(location(text), text, out)
    except OSError as err:
        raise RecordingError(f"{err.filename}: cannot be searched for recordings: {err.strerror}") from err
    if not jobs:
        raise RecordingError("expected recordings, found none")
    by_name: dict[str, BatchJob] = {}
    for job in _told_apart(jobs):
        other = by_name.setdefault(job.name, job)
        if other.inputs != job.inputs:
            raise RecordingError(
                f"{job.inputs[0]} and {other.inputs[0]} would both become {job.name}.mcap: give the folder that "
                "holds both, so that results have the names of their folders, too"
            )
    return [by_name[name] for name in sorted(by_name, key=natural_key)]


def _told_apart(jobs: Sequence[BatchJob]) -> list[BatchJob]:
    """The jobs; of recordings beside each other whose names differ by their ending, that is a part of the name."""
    inputs = defaultdict[str, set[tuple[Location, ...]]](set)
    for job in jobs:
        inputs[job.name].add(job.inputs)
    told = []
    for job in jobs:
        beside = {str(one[0])[: -len(one[0].name)] for one in inputs[job.name]}
        suffix = PurePath(job.inputs[0].name).suffix
        is_twin = len(inputs[job.name]) > 1 and len(beside) == 1 and not job.fault
        told.append(replace(job, name=f"{job.name}{suffix}") if is_twin else job)
    return told


def _lines(text: str) -> list[str]:
    """The lines of the list that a text names; else the text."""
    if not text.startswith("@"):
        return [text]
    found = read_small_text(Path(text[1:]), MAX_LIST_BYTES, "a list of recordings", RecordingError)
    return [line for line in map(str.strip, found.splitlines()) if line and not line.startswith("#")]


def _listed(given: Iterable[str], out: Location) -> Iterator[str]:
    for text in chain.from_iterable(map(_lines, given)):
        if "://" not in text and not Path(text).exists() and glob.has_magic(text):
            found = sorted(glob.glob(text, recursive=True))  # noqa: PTH207  # absolute or relative, as it was given
            if not found:
                raise RecordingError(f"{text}: expected recordings, found nothing of this pattern")
            yield from (one for one in found if not isinstance(out, Path) or Path(one).resolve() != out.resolve())
        else:
            yield text


def _of(place: Location, text: str, out: Location) -> list[BatchJob]:
    if isinstance(place, RemotePath):
        if not is_bucket(place) or place.name.lower().endswith(ENDINGS):
            return [_job((place,), place.name, 0)]
        return _of_bucket(place, out)
    if not place.is_dir() and not place.is_file():
        what = "a device or a pipe" if place.exists() else "nothing of this name"
        raise RecordingError(f"{text}: expected a recording or a folder of recordings, found {what}")
    if place.is_file() or _is_recording(place):
        name = place.name if place.name not in {"", ".."} else place.resolve().name
        return [_job((place,), name, _bytes(place))]
    skipped = out.resolve() if isinstance(out, Path) else None
    if place.resolve() == skipped:
        raise RecordingError(f"{text}: {OTHER_FOLDER}")
    found = [*_recordings(place, skipped)]
    if not found:
        raise RecordingError(f"{text}: {NONE_FOUND}")
    return [_job(parts, parts[0].relative_to(place).as_posix(), sum(map(_bytes, parts))) for parts in _split(found)]


def _of_bucket(place: RemotePath, out: Location) -> list[BatchJob]:
    """The recordings below a URL; those of formats that are only read locally fail later, with a line."""
    root, skipped = f"{place.url.rstrip('/')}/", f"{out.url.rstrip('/')}/" if isinstance(out, RemotePath) else None
    if root == skipped:
        raise RecordingError(f"{place}: {OTHER_FOLDER}")
    sizes = {
        one: size
        for one, size in Bucket(place).found()
        if one.url.lower().endswith(ENDINGS) and not (skipped and one.url.startswith(skipped))
    }
    if not sizes:
        raise RecordingError(f"{place}: {NONE_FOUND}")
    return [
        _job(parts, parts[0].url.removeprefix(root), sum(sizes[one] for one in parts)) for parts in _split([*sizes])
    ]


def _recordings(folder: Path, out: Path | None) -> Iterator[Path]:
    """The recordings in and below a folder, in natural order, without results; links to folders are not followed."""
    left = [folder]
    while left:
        path = left.pop()
        if path == folder or (path.is_dir() and not _is_recording(path)):
            found = [one for one in path.iterdir() if _is_searched(one, out)]
            left += sorted(found, key=lambda one: natural_key(one.name), reverse=True)
        else:
            yield path


def _is_searched(path: Path, out: Path | None) -> bool:
    """Whether what lies in a folder is a recording, or a folder that may hold some."""
    if path.is_dir():
        is_of_results = path.resolve() == out or path.suffix == ".lidcam" or (path / RECORDS).is_dir()
        return not path.is_symlink() and not is_of_results and not path.name.startswith(".")
    return path.is_file() and path.name.lower().endswith(ENDINGS) and not path.name.startswith(".")


def _is_recording(folder: Path) -> bool:
    return (folder / METADATA).is_file()


def _split(paths: Iterable[L]) -> Iterator[list[L]]:
    """Groups the parts of split recordings: `drive_0.bag`, `drive_1.bag`, ... that follow one another in time."""
    parts: list[L] = []
    for path in paths:
        if parts and not _goes_on(parts[-1], path):
            yield parts
            parts = []
        parts.append(path)
    if parts:
        yield parts


def _goes_on(before: Location, path: Location) -> bool:
    (folder, stem, ending), (other_folder, other_stem, other_ending) = map(_split_name, (before, path))
    one, other = PART.fullmatch(stem), PART.fullmatch(other_stem)
    if one is None or other is None or folder != other_folder or (isinstance(path, Path) and path.is_dir()):
        return False
    if (one[1], ending) != (other[1], other_ending) or int(one[2]) + 1 != int(other[2]):
        return False
    try:
        with open_recording([before]) as first, open_recording([path]) as second:
            is_later = first.start_ns < second.start_ns and first.end_ns < second.end_ns  # no copy of it
            return is_later and -MAX_OVERLAP_NS < second.start_ns - first.end_ns < MAX_PAUSE_NS
    except LidcamError:
        return False  # each gets a job of its own, which reports the error


def _split_name(place: Location) -> tuple[str, str, str]:
    """Folder, name without ending, and ending."""
    stem = recording_stem(place.name)
    folder = str(place.parent) if isinstance(place, Path) else place.url.rpartition("/")[0]
    return folder, stem, place.name.removeprefix(stem)


def _job(parts: Sequence[Location], name: str, size: int) -> BatchJob:
    """The job of a recording, of which `name` is the name with its ending, below the folder that was given."""
    folder, slash, last = name.rpartition("/")
    stem = recording_stem(last)
    if len(parts) > 1 and (match := PART.fullmatch(stem)):
        stem = match[1]
    if fault := name_fault(f"{folder}{slash}{stem}"):
        return BatchJob(tuple(parts), visible(name), size, fault)
    return BatchJob(tuple(parts), f"{folder}{slash}{stem}", size)


def name_fault(name: str) -> str:
    """The reason why no result can have a name, as that of a recording in a bucket may be anything; empty: none."""
    parts = name.split("/")
    if not {"", ".", ".."}.isdisjoint(parts):
        found = "an empty one, '.' or '..'"
    elif any(letter == "\\" or category(letter) in {"Cc", "Cs"} for letter in name):
        found = "a backslash, a control character or bytes that are no UTF-8"
    elif name in {TABLE_STEM, PurePath(INDEX).stem} or any(re.match(r"\.(.*\.)?lidcam-", part) for part in parts):
        found = f"what lidcam itself writes ({RECORDS}, {TABLE_STEM}, {INDEX}, .NAME.lidcam-)"
    elif max(len(part.encode()) for part in parts) > MAX_NAME_BYTES:
        found = f"one of more than {MAX_NAME_BYTES} bytes"
    else:
        return ""
    return f"its results cannot have its name: expected plain names between slashes, found {found}; rename it"


def _bytes(path: Path) -> int:
    return sum(one.stat().st_size for one in files_of(path))


def files_of(path: Path) -> list[Path]:
    """The files of a local recording: itself, or those in the folder of a ROS 2 bag, in order of name."""
    return sorted(one for one in path.iterdir() if one.is_file()) if path.is_dir() else [path]
