"""What stands where an output is to be written: told by the content, never by the name."""

import os
import re
import stat
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Literal

import yaml
from rosbags.rosbag1 import Reader

from pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES, parse_yaml
from readers.files.mcap.index import FOOTER, MAGIC_BYTES, summary_checksum
from writers.outputs.marked_text import is_unchanged_text
from writers.outputs.marks import APPLICATION, BAG_CALLER, FOLDER_DATA, LIBRARY, MERGED, REPAIRED, RESULT, SIMULATED

__all__ = ["Made", "made_by_lidcam"]

Made = Literal["result", "repaired", "simulated", "merged", "text"]
"""A result of `process` (MCAP, .rrd); what `inspect --repair` wrote; a simulated recording; what `compare --merged`
wrote; a text that is unchanged: a layout, a draft of a rig, the rig and the scenario beside a simulated recording."""

_MCAP, _BAG, _RRD = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"RRF2"
_MAX_SUMMARY_BYTES = 256 << 20
_MAX_TEXT_BYTES = 16 << 20
_METADATA_INDEX = 0x0D
_RRD_HEAD_BYTES = 1 << 12
_RRD_STORE = re.compile(rb"\x12\x20[0-9a-f]{32}\x1a.\n" + re.escape(bytes([len(APPLICATION)]) + APPLICATION.encode()))
"""Of the first message of an .rrd: recording id and application id, as protobuf."""

_BY_METADATA: dict[str, Made] = {RESULT: "result", REPAIRED: "repaired", SIMULATED: "simulated", MERGED: "merged"}


def made_by_lidcam(path: Path) -> Made | None:
    """What lidcam made a file or folder for; None: it did not, or it is unfinished, damaged or changed.

    Raises:
        OSError: it cannot be read.
    """
    if path.is_dir():
        return _made_folder(path)
    with path.open("rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            return None
        head = file.read(_RRD_HEAD_BYTES)
        if head.startswith(_MCAP):
            return _made_mcap(file, head)
        if head.startswith(_BAG):
            return _made_bag(path)
        if head.startswith(_RRD):
            return "result" if _RRD_STORE.search(head) else None
        file.seek(0)
        text = file.read(_MAX_TEXT_BYTES).decode(errors="replace")
        return "text" if is_unchanged_text(text) else None


def _made_mcap(file: BinaryIO, head: bytes) -> Made | None:
    try:
        profile_size = struct.unpack_from("<I", head, MAGIC_BYTES + 9)[0]
        size = struct.unpack_from("<I", head, MAGIC_BYTES + 13 + profile_size)[0]
        library = head[MAGIC_BYTES + 17 + profile_size :][:size]
        if library != LIBRARY.encode() or summary_checksum(file) != "right":
            return None
        end = file.seek(-FOOTER.size - MAGIC_BYTES, os.SEEK_END)
        _, _, start, _, _ = FOOTER.unpack(file.read(FOOTER.size))
        if file.read() != _MCAP or not 0 < start <= end <= start + _MAX_SUMMARY_BYTES:
            return None
        file.seek(start)
        names = _metadata_names(file.read(end - start))
        return next((_BY_METADATA[name] for name in names if name in _BY_METADATA), None)
    except (struct.error, ValueError, OSError):
        return None


def _metadata_names(summary: bytes) -> Iterator[str]:
    position = 0
    while position < len(summary):
        kind, size = struct.unpack_from("<BQ", summary, position)
        if kind == _METADATA_INDEX:
            (length,) = struct.unpack_from("<I", summary, position + 25)
            yield summary[position + 29 :][:length].decode()
        position += 9 + size


def _made_bag(path: Path) -> Made | None:
    try:
        with Reader(path) as reader:
            is_simulated = bool(reader.connections) and all(
                getattr(connection.ext, "callerid", None) == BAG_CALLER for connection in reader.connections
            )
    except Exception:  # whatever the library raises: it is not as lidcam left it
        return None
    return "simulated" if is_simulated else None


def _made_folder(path: Path) -> Made | None:
    try:
        with (path / "metadata.yaml").open("rb") as file:
            facts = parse_yaml(file.read(MAX_YAML_BYTES + 1))["rosbag2_bagfile_information"]
        is_simulated = facts["custom_data"] == FOLDER_DATA
        names = {"metadata.yaml", *facts["relative_file_paths"]}
    except (OSError, yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError):
        return None
    return "simulated" if is_simulated and names == {file.name for file in path.iterdir()} else None
