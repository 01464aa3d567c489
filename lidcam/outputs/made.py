"""Files that lidcam wrote itself, recognised by the marks that they carry (`writers.outputs.marks`).

Each function returns False for a file that is unfinished or damaged, and raises OSError for one that cannot be read.
"""

import re
import struct
from pathlib import Path

import yaml
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from rosbags.rosbag1 import Reader

from pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES, parse_yaml
from writers.outputs.marked_text import is_unchanged_text
from writers.outputs.marks import APPLICATION, BAG_CALLER, FOLDER_DATA, LIBRARY, SIMULATED

__all__ = ["is_marked_mcap", "is_marked_rrd", "is_simulated", "is_unchanged"]

MAX_TEXT_BYTES = 16 << 20
RRD_HEAD_BYTES = 1 << 12
RRD_STORE = re.compile(rb"\x12\x20[0-9a-f]{32}\x1a.\n" + re.escape(bytes([len(APPLICATION)]) + APPLICATION.encode()))
"""Of the first message of an .rrd: recording id and application id, as protobuf."""


def is_marked_mcap(path: Path, mark: str) -> bool:
    """Whether a file is an MCAP of lidcam that was closed and has a metadata record of this name."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        try:
            reader = SeekingReader(file)
            summary = reader.get_summary()
            is_own = reader.get_header().library == LIBRARY
        except (McapError, struct.error, ValueError, OSError):
            return False
    return is_own and summary is not None and mark in {index.name for index in summary.metadata_indexes}


def is_marked_rrd(path: Path) -> bool:
    """Whether a file is a Rerun recording of lidcam."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(RRD_HEAD_BYTES)
    return head.startswith(b"RRF2") and RRD_STORE.search(head) is not None


def is_simulated(path: Path) -> bool:
    """Whether a file or folder is a recording of the simulator."""
    if path.is_dir():
        return _is_simulated_folder(path)
    return is_marked_mcap(path, SIMULATED) or (path.is_file() and _is_simulated_bag(path))


def is_unchanged(path: Path) -> bool:
    """Whether a file is a text of lidcam that nobody has changed."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return is_unchanged_text(file.read(MAX_TEXT_BYTES).decode(errors="replace"))


def _is_simulated_bag(path: Path) -> bool:
    try:
        with Reader(path) as reader:
            callers = {getattr(connection.ext, "callerid", None) for connection in reader.connections}
    except Exception:  # whatever the library raises: it is not as lidcam left it
        return False
    return callers == {BAG_CALLER}


def _is_simulated_folder(path: Path) -> bool:
    try:
        with (path / "metadata.yaml").open("rb") as file:
            facts = parse_yaml(file.read(MAX_YAML_BYTES + 1))["rosbag2_bagfile_information"]
        names = {"metadata.yaml", *facts["relative_file_paths"]}
        return facts["custom_data"] == FOLDER_DATA and names == {file.name for file in path.iterdir()}
    except (OSError, yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError):
        return False
