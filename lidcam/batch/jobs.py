"""The recordings of a batch: files, folders with their subfolders, patterns, and lists."""

import glob
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TypeVar

from lidcam.outputs.bucket import Bucket, is_bucket
from lidcam.pipeline.core.errors import LidcamError, RecordingError
from lidcam.readers.location import Location, RemotePath, location
from lidcam.readers.natural_order import natural_key
from lidcam.readers.open import open_recording

ENDINGS = (".bag", ".mcap", ".db3", ".pcap", ".pcapng", ".bag.zst", ".mcap.zst", ".db3.zst")
"""Endings of the recordings that are found in folders. A file that is named itself may be called anything."""

METADATA = "metadata.yaml"
"""File in the folder of a ROS 2 bag, which is one recording."""

PART = re.compile(r"(.+)_(\d+)")
"""Name of a part of a split recording, without ending."""

MAX_PAUSE_NS = 5_000_000_000
"""Longest pause between the parts of a split recording."""

OTHER_FOLDER = "expected another folder for the results: the next batch would take them for recordings"
NONE_FOUND = f"expected recordings ({', '.join(ENDINGS)}) in it, found none"

L = TypeVar("L", Path, RemotePath)


@dataclass(frozen=True, slots=True)
class BatchJob:
    """One recording of a batch."""

    inputs: tuple[Location, ...]  # The recording, or all parts of a split one in order
    name: str  # Name of its results, without ending, below the folder of the batch: `day1/drive`
    bytes: int  # Size of the files; 0 if unknown


def find_jobs(given: Sequence[str], out: Location) -> list[BatchJob]:
    """One job per recording, ordered by name.

    Args:
        given: Recordings, folders (also `s3://bucket/logs`), patterns (`'logs/*.bag'`), URLs, and `@list.txt` with one
            of these per line.
        out: The folder of the results; it is not searched.

    Raises:
        RecordingError: an input does not exist, a folder holds no recording or cannot be listed, or two results would
            have the same name.
    """
    jobs: list[BatchJob] = []
    for text in _listed(given):
        jobs += _of(location(text), text, out)
    by_name: dict[str, BatchJob] = {}
    for job in jobs:
        other = by_name.setdefault(job.name, job)
        if other.inputs != job.inputs:
            raise RecordingError(
                f"{job.inputs[0]} and {other.inputs[0]} would both become {job.name}.mcap: give the folder that "
                "holds both, so that results have the names of their folders, too"
            )
    return [by_name[name] for name in sorted(by_name, key=natural_key)]


def _listed(given: Iterable[str]) -> Iterator[str]:
    for text in given:
        if text.startswith("@"):
            try:
                lines = Path(text[1:]).read_text(encoding="utf-8").splitlines()
            except (OSError, ValueError) as err:
                raise RecordingError(f"{text[1:]}: expected a list of recordings, one per line: {err}") from err
            yield from (line.strip() for line in lines if line.strip() and not line.startswith("#"))
        elif "://" not in text and not Path(text).exists() and glob.has_magic(text):
            found = sorted(glob.glob(text, recursive=True))  # noqa: PTH207  # absolute or relative, as it was given
            if not found:
                raise RecordingError(f"{text}: expected recordings, found nothing of this pattern")
            yield from found
        else:
            yield text


def _of(place: Location, text: str, out: Location) -> list[BatchJob]:
    if isinstance(place, RemotePath):
        if not is_bucket(place) or place.name.lower().endswith(ENDINGS):
            return [BatchJob((place,), _stem(place.name), 0)]
        return _of_bucket(place, out)
    if not place.exists():
        raise RecordingError(f"{text}: expected a recording or a folder of recordings, found nothing of this name")
    if not place.is_dir() or _is_recording(place):
        return [BatchJob((place,), _stem(place.name), _bytes(place))]
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
        if one.name.lower().endswith(ENDINGS) and not (skipped and one.url.startswith(skipped))
    }
    if not sizes:
        raise RecordingError(f"{place}: {NONE_FOUND}")
    return [
        _job(parts, parts[0].url.removeprefix(root), sum(sizes[one] for one in parts)) for parts in _split([*sizes])
    ]


def _recordings(folder: Path, out: Path | None) -> Iterator[Path]:
    """The recordings in a folder and below it, in natural order; links to folders are not followed."""
    for path in sorted(folder.iterdir(), key=lambda one: natural_key(one.name)):
        if path.is_dir() and not path.is_symlink() and path.resolve() != out and not path.name.startswith("."):
            if _is_recording(path):
                yield path
            else:
                yield from _recordings(path, out)
        elif path.is_file() and path.name.lower().endswith(ENDINGS):
            yield path


def _is_recording(folder: Path) -> bool:
    return (folder / METADATA).is_file()


def _split(paths: Iterable[L]) -> Iterator[list[L]]:
    """Groups the parts of split recordings: `drive_0.bag`, `drive_1.bag`, ... that follow one another in time."""
    parts: list[L] = []
    for path in paths:
        if parts and _goes_on(parts[-1], path):
            parts.append(path)
            continue
        if parts:
            yield parts
        parts = [path]
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
            return -MAX_PAUSE_NS < second.start_ns - first.end_ns < MAX_PAUSE_NS
    except LidcamError:
        return False  # each gets a job of its own, which reports the error


def _split_name(place: Location) -> tuple[str, str, str]:
    """Folder, name without ending, and ending."""
    stem = _stem(place.name)
    folder = str(place.parent) if isinstance(place, Path) else place.url.rpartition("/")[0]
    return folder, stem, place.name.removeprefix(stem)


def _job(parts: Sequence[Location], name: str, size: int) -> BatchJob:
    path = PurePosixPath(name)
    stem = _stem(path.name)
    if len(parts) > 1 and (match := PART.fullmatch(stem)):
        stem = match[1]
    return BatchJob(tuple(parts), str(path.parent / stem), size)


def _stem(name: str) -> str:
    """A name without the ending of a recording."""
    lower = name.lower()
    ending = max((one for one in ENDINGS if lower.endswith(one)), key=len, default="")
    return name[: len(name) - len(ending)] or name


def _bytes(path: Path) -> int:
    return sum(one.stat().st_size for one in path.rglob("*") if one.is_file()) if path.is_dir() else path.stat().st_size
