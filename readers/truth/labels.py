"""Truth that is no recording: label files and folders, told apart by their content."""

from pathlib import Path

from pipeline.core.errors import RecordingError
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from readers.files.pcap.packets import is_capture
from readers.open import MCAP_MAGIC, ROSBAG1_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC
from readers.truth.kitti import KittiTruth, is_kitti_text
from readers.truth.openlabel import OpenLabelTruth, is_openlabel
from readers.truth.predecessor import PredecessorTruth
from readers.truth.source import TruthSource

__all__ = ["open_labels"]

_RECORDINGS = (ROSBAG1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC)
_RECORDING_SUFFIXES = (".mcap", ".db3", ".zstd")
_HEAD_BYTES = 1 << 12

MAX_NAMED = 5
"""Names in a folder that an error lists."""

_EXPECTED = (
    "a recording, a result, KITTI's labels (a .txt of label_2 or label_02, or the folder), an OpenLABEL .json, or a "
    "folder with odom/*.txt as the predecessor system evaluates"
)


def open_labels(path: Path, rig: Rig, config: Config) -> TruthSource | None:
    """The labels at a path as a source of truth; None if a recording lies there.

    Args:
        path: A file or folder; its content says what it is, not its name.
        rig: The rig of the result that is evaluated.
        config: Its settings.

    Raises:
        RecordingError: there is nothing, nothing that is known, or the labels cannot be read.
    """
    try:
        if path.is_dir():
            return _of_folder(path, rig, config)
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except FileNotFoundError as err:
        raise RecordingError(f"{path}: no such file or folder; expected truth: {_EXPECTED}") from err
    except OSError as err:
        raise RecordingError(f"{path}: cannot be read: {err.strerror or err}") from err
    if head.startswith(_RECORDINGS) or is_capture(head):
        return None
    text = head.decode(errors="replace")
    if is_openlabel(text):
        return OpenLabelTruth(path, rig, config)
    if is_kitti_text(text):
        return KittiTruth(path, rig, config)
    raise RecordingError(f"{path}: expected truth: {_EXPECTED}, found a file of another kind")


def _of_folder(path: Path, rig: Rig, config: Config) -> TruthSource | None:
    if (path / "odom").is_dir():
        return PredecessorTruth(path, rig, config)
    names = [file.name for file in path.iterdir()]
    if "metadata.yaml" in names or any(name.endswith(_RECORDING_SUFFIXES) for name in names):
        return None
    if any(name.endswith(".json") for name in names):
        return OpenLabelTruth(path, rig, config)
    if "label_2" in names or any(name.endswith(".txt") for name in names):
        return KittiTruth(path, rig, config)
    found = f"a folder with {', '.join(sorted(names)[:MAX_NAMED])}" if names else "an empty folder"
    raise RecordingError(f"{path}: expected truth: {_EXPECTED}, found {found}")
