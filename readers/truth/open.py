"""Finding the truth about a result: in the result itself, in another recording, or in label files."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.files.pcap.packets import is_capture
from lidcam.readers.location import Location
from lidcam.readers.messages.tf import read_transforms
from lidcam.readers.open import MCAP_MAGIC, ROSBAG1_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC, open_recording
from lidcam.readers.recording import ReadOptions, Recording
from lidcam.readers.results.attached_records import is_result
from lidcam.readers.results.result import RESULT_TOPICS, Result
from lidcam.readers.truth.kitti import KittiTruth, is_kitti_text
from lidcam.readers.truth.odometry import OdometryTruth
from lidcam.readers.truth.recorded import RecordedTruth
from lidcam.readers.truth.source import TruthSource
from lidcam.readers.truth.topics import find_truth_topics

_RECORDINGS = (ROSBAG1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC)
_RECORDING_SUFFIXES = (".mcap", ".db3", ".zstd")
_HEAD_BYTES = 1 << 12

MAX_NAMED = 5
"""Largest number of names in a folder that an error lists."""

_EXPECTED = "a recording, a result, or KITTI's labels (a .txt of label_2 or label_02, or the folder)"


class OpenTruth(NamedTuple):
    """The truth about a result; `open_truth` opens it."""

    source: TruthSource | None  # None if there is none
    reason: str  # Why there is none; empty if there is one
    poses: tuple[Recording, ...]  # Recordings that may join the truth's frame with the site frame, the best first


@contextmanager
def open_truth(result: Result, paths: Sequence[Location] = (), *, topic: str = "") -> Iterator[OpenTruth]:
    """Find the truth.

    Args:
        result: The open result.
        paths: The files of a recording with the truth, in any container, or labels (see `open_labels`); none: the truth
            that the result carries.
        topic: The topic to take, by any name; empty to find it.

    Raises:
        ConfigError: there is no such topic, or a vehicle of the rig's truth has no configured class.
        RecordingError: the truth cannot be read, or there is none at `paths`. A result without truth is no error.
    """
    own = result.recording
    if len(paths) == 1 and isinstance(paths[0], Path) and not topic:
        labels = open_labels(paths[0], result.rig, result.config)
        if labels is not None:
            yield OpenTruth(labels, "", (own,))
            return
    if not paths:
        source = _recorded(own, RESULT_TOPICS, result, topic)
        if isinstance(source, str):
            yield OpenTruth(None, f"{source}; give the recording that has it (--truth)", (own,))
        else:
            yield OpenTruth(source, "", (own,))
        return
    results = RESULT_TOPICS if any(isinstance(path, Path) and is_result(path) for path in paths) else frozenset()
    with open_recording(paths, ReadOptions(limits=result.config.limits)) as recording:
        source = _recorded(recording, results, result, topic)
        if isinstance(source, str):
            raise RecordingError(source)
        yield OpenTruth(source, "", (recording, own))


def _recorded(recording: Recording, results: frozenset[str], result: Result, topic: str) -> TruthSource | str:
    """The truth of a recording, or why it has none; `results` are topics that are no truth.

    It is the vehicles that the rig calls truth, if the odometry of one was recorded and no topic is asked for.
    """
    vehicles = result.rig.truth
    recorded = {info.topic for info in recording.topics if info.message_count}
    if not topic and any(vehicle.topic in recorded for vehicle in vehicles.values()):
        transforms = read_transforms(recording, limits=result.config.limits)
        return OdometryTruth(recording, vehicles, transforms, result.config)
    sources = {text for key, text in result.metadata.items() if re.fullmatch(r"boxes3d\.\d+\.topic", key)}
    found = find_truth_topics(recording, results, topic, sources=sources)
    return found if isinstance(found, str) else RecordedTruth(recording, found, result.rig.cameras, result.config)


def open_labels(path: Path, rig: Rig, config: Config) -> TruthSource | None:
    """The labels at a path as a source of truth; None if a recording lies there.

    The content says what lies there, not the name; rig and settings are those of the result that is evaluated. Raises
    RecordingError if there is nothing, nothing that is known, or the labels cannot be read.
    """
    try:
        if path.is_dir():
            return _of_folder(path, rig, config)
        if path.exists() and not path.is_file():
            raise RecordingError(f"{path}: expected truth: {_EXPECTED}, found a FIFO or a device")
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except FileNotFoundError as err:
        raise RecordingError(f"{path}: no such file or folder; expected truth: {_EXPECTED}") from err
    except OSError as err:
        raise RecordingError(f"{path}: cannot be read: {err.strerror or err}") from err
    if head.startswith(_RECORDINGS) or is_capture(head):
        return None
    text = head.decode(errors="replace")
    if is_kitti_text(text):
        return KittiTruth(path, rig, config)
    raise RecordingError(f"{path}: expected truth: {_EXPECTED}, found a file of another kind")


def _of_folder(path: Path, rig: Rig, config: Config) -> TruthSource | None:
    names = [file.name for file in path.iterdir()]
    if "metadata.yaml" in names or any(name.endswith(_RECORDING_SUFFIXES) for name in names):
        return None
    if "label_2" in names or any(name.endswith(".txt") for name in names):
        return KittiTruth(path, rig, config)
    found = f"a folder with {', '.join(sorted(names)[:MAX_NAMED])}" if names else "an empty folder"
    raise RecordingError(f"{path}: expected truth: {_EXPECTED}, found {found}")
