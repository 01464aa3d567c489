"""The records attached to a result: its inputs, settings and rig."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

from mcap.reader import SeekingReader
from mcap.records import Attachment, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader

from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.files.damage import DamageGuard, library_errors

RESULT = "lidcam"
"""Name of the metadata record of a result."""

INPUTS = "lidcam.inputs"
"""Name of the metadata record of the checksums of its inputs; missing where the file was not closed."""

CONFIG = "lidcam.yaml"
"""Name of the attached settings."""

RIG = "rig.yaml"
"""Name of the attached rig."""

SUMMARY = "summary.json"
"""Name of the attached summary of the run (used, dropped, warned of); missing where the file was not closed."""

NAMES = frozenset({CONFIG, RIG, SUMMARY})

MAX_ATTACHMENT_BYTES = 1 << 20

MAX_NAMED = 3
"""Maximum number of results in a folder that an error names."""

_MAGIC = b"\x89MCAP0\r\n"


def read_records(path: Path) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """The records of a result: version of lidcam, inputs and hashes; and the attached texts by name.

    Raises:
        RecordingError: the file cannot be read, or is not a result of lidcam; says what it is.
    """
    with library_errors(path):
        if not path.exists():
            raise RecordingError(f"{path}: expected a result of lidcam, found no such file")
        if path.is_dir():
            files = ", ".join(str(file) for file in sorted(path.glob("*.mcap"))[:MAX_NAMED]) or "no .mcap file in it"
            raise RecordingError(f"{path}: expected a result of lidcam, an .mcap file, found a folder: {files}")
        if not path.is_file():
            raise RecordingError(f"{path}: expected a result of lidcam, an .mcap file, found a FIFO or a device")
        with path.open("rb") as stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise RecordingError(
                    f"{path}: expected a result of lidcam, an .mcap file, found another kind of file; give the file "
                    "that `lidcam process` wrote"
                )
            metadata, texts = _records(stream)
    if RESULT not in metadata:
        raise RecordingError(
            f"{path}: expected a result of lidcam, found a recording; run `lidcam process {shlex.quote(str(path))} "
            "OUT.mcap` first, and give OUT.mcap"
        )
    missing = [name for name in (CONFIG, RIG) if name not in texts]
    if missing:
        raise RecordingError(
            f"{path}: expected a result with {CONFIG} and {RIG} attached, found none of {', '.join(missing)}: a tool "
            "that rewrote it left them out; give the file that `lidcam process` wrote"
        )
    return metadata[RESULT] | metadata.get(INPUTS, {}), texts


def is_result(path: Path) -> bool:
    """Whether a file is a result of lidcam; False of any other file. Raises RecordingError if it cannot be read."""
    with library_errors(path):
        if not path.is_file():
            return False
        with path.open("rb") as stream:
            return stream.read(len(_MAGIC)) == _MAGIC and RESULT in _records(stream)[0]


_Records = tuple[dict[str, dict[str, str]], dict[str, str]]


def _records(stream: BinaryIO) -> _Records:
    return _of_summary(stream) or _of_beginning(stream)


def _of_summary(stream: BinaryIO) -> _Records | None:
    """Metadata and texts by the file's index; None if it has none, or if it is damaged."""
    stream.seek(0)
    reader = SeekingReader(stream)
    with DamageGuard(is_active=True):
        summary = reader.get_summary()
        if summary is not None:
            attachments: list[McapRecord] = []
            for index in summary.attachment_indexes:
                if index.name in NAMES and index.data_size <= MAX_ATTACHMENT_BYTES:
                    stream.seek(index.offset)
                    attachments.append(
                        next(StreamReader(stream, skip_magic=True, record_size_limit=2 * MAX_ATTACHMENT_BYTES).records)
                    )
            return _sorted_out([*reader.iter_metadata()], attachments)
    return None


def _of_beginning(stream: BinaryIO) -> _Records:
    """Metadata and texts before the first message, where lidcam writes them: of a file that was not closed."""
    stream.seek(0)
    before: list[McapRecord] = []
    with DamageGuard(is_active=True):  # the file ends there
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk | Message):
                break
            if isinstance(record, Attachment | Metadata):
                before.append(record)
    return _sorted_out([one for one in before if isinstance(one, Metadata)], before)


def _sorted_out(metadata: list[Metadata], records: list[McapRecord]) -> _Records:
    texts = {
        one.name: one.data.decode()
        for one in records
        if isinstance(one, Attachment) and one.name in NAMES and len(one.data) <= MAX_ATTACHMENT_BYTES
    }
    return {one.name: dict(one.metadata) for one in metadata}, texts
