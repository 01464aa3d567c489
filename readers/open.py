"""Opening recordings: one file, a ROS 2 bag folder, or the files of a split recording, as one stream of messages.

The readers of a format are imported by the first file of it.
"""

import heapq
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import BinaryIO

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.small_files import LFS_POINTER, LFS_REMEDY
from lidcam.readers.files.container import Source
from lidcam.readers.files.copies import completed, journals_of, unpacked, whole_pages
from lidcam.readers.files.damage import DamageError, Losses, library_errors
from lidcam.readers.files.rosbag2_folder import folder_metadata, recording_files, unlisted_files
from lidcam.readers.input_file import OpenedFile
from lidcam.readers.location import Location, RemotePath
from lidcam.readers.messages.registry import types_of
from lidcam.readers.recording import (
    DEFAULT_READ_OPTIONS,
    Closing,
    Loss,
    ReadOptions,
    Recording,
    RecordingFile,
    RosVersion,
    TopicInfo,
    merge_topics,
)

ROSBAG1_MAGIC = b"#ROSBAG V2.0\n"
MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\0"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

OTHER_KINDS = {
    LFS_POINTER: LFS_REMEDY,
    b"\x1f\x8b": "a file compressed with gzip; unpack it with `gunzip --keep`",
    b"BZh": "a file compressed with bzip2; unpack it with `bunzip2 --keep`",
    b"\xfd7zXZ\0": "a file compressed with xz; unpack it with `unxz --keep`",
    b"PK\3\4": "a zip archive; unpack it with `unzip`",
    b"RRF": "a Rerun recording, which is for viewing; process the recording that it was made of",
}
"""Files that are taken for recordings, by their first bytes, and what to do."""

OSF_MARK = b"OSF$"
"""Name of the header of Ouster's format, behind two numbers (ouster-sdk, ouster_osf/fb/header.fbs)."""

TAR_MARK_AT = 257
"""Bytes before the mark of a tar archive."""

MAX_OVERLAP_NS = 500_000_000
"""Longest time over which two parts of one recording overlap: messages on their way come with the next part."""

EXPECTED = "a ROS 1 .bag (format 2.0), a ROS 2 .mcap or .db3 file, a ROS 2 bag folder, or a .pcap or .pcapng capture"


def open_recording(paths: Sequence[Location], options: ReadOptions = DEFAULT_READ_OPTIONS) -> Recording:
    """Open one recording, to be used as a context manager.

    Formats are recognised by the first bytes, not by the name. MCAP files may be on a server; only the parts that are
    needed are fetched.

    `paths` are a file, a ROS 2 bag folder, or all files of a split recording in their order, which is that of messages
    of equal log time.

    Raises:
        RecordingError: a path is not a recording, contains nothing that can be read, or is given twice, or ROS 1 and
            ROS 2 files, or two recordings of the same time, are mixed. No file stays open then.
    """
    if not paths:
        raise RecordingError(f"expected {EXPECTED}, got no path")
    with ExitStack() as stack:
        opened: list[RecordingFile] = []
        files, unlisted = _all_files(paths), _unlisted(paths, options)
        originals = [OpenedFile(path, _stream(path, stack)) for path in files]
        errors: list[DamageError] = []
        for index, original in enumerate(originals):
            try:
                opened.append(_open_file(original, index, stack, options))
            except DamageError as err:  # also the last file of a killed recorder, to which it had not yet written
                if options.recovery == "none":
                    raise
                errors.append(err)
                opened.append(_LostFile(original.path, err))
        if len(errors) == len(files):
            raise errors[0]
        of_ros = [file for file in opened if file.ros_version != "no ROS"]
        for file in of_ros:
            if file.ros_version != of_ros[0].ros_version:
                raise RecordingError(
                    f"expected the files of one recording, found {of_ros[0].ros_version} ({of_ros[0].path}) and "
                    f"{file.ros_version} ({file.path}); process them one by one"
                )
        _check_follow_one_another(opened)
        recording = _FilesRecording(tuple(opened), originals, stack.pop_all(), unlisted)
    if len(recording.topics) > options.limits.max_topics:
        recording.close()
        raise RecordingError(
            f"{', '.join(map(str, recording.paths))}: {len(recording.topics)} topics, expected at most "
            f"{options.limits.max_topics}: raise limit_scale"
        )
    return recording


def _check_follow_one_another(files: Sequence[RecordingFile]) -> None:
    """Parts of a recording follow one another, or hold other sensors.

    Raises:
        RecordingError: two files have the same lidar or camera over the same time: they are two recordings.
    """
    kinds = types_of("cloud") | types_of("image")
    sensors = [{info.topic for info in file.topics if info.msgtype in kinds and info.message_count} for file in files]
    for (one, its_topics), (other, others_topics) in combinations(zip(files, sensors, strict=True), 2):
        shared = sorted(its_topics & others_topics)
        overlap_ns = min(one.end_ns, other.end_ns) - max(one.start_ns, other.start_ns)
        shorter_ns = min(one.end_ns - one.start_ns, other.end_ns - other.start_ns)
        if shared and overlap_ns > max(MAX_OVERLAP_NS, shorter_ns // 2):
            raise RecordingError(
                f"expected the parts of one recording, found two recordings of the same time: {one.path} and "
                f"{other.path} both hold {shared[0]} over the same {overlap_ns / 1e9:.1f} s; process them one by one"
            )


class _LostFile:
    """A file of a split recording that cannot be read at all; see `RecordingFile`."""

    ros_version: RosVersion = "no ROS"
    topics: tuple[TopicInfo, ...] = ()
    start_ns = end_ns = message_count = 0

    def __init__(self, path: Location, error: DamageError) -> None:
        self.path = path
        reason = str(error).removeprefix(f"{path}: ")
        size = path.stat().st_size if isinstance(path, Path) else None
        self.losses: tuple[Loss, ...] = (Loss(path, 0, reason, size),)

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """No messages."""
        del topics, start_ns, stop_ns
        return iter(())

    def close(self) -> None:
        """Nothing to close."""


class _FilesRecording(Closing):
    """The files of one recording, merged by time; see `Recording`."""

    def __init__(
        self,
        files: tuple[RecordingFile, ...],
        originals: Sequence[OpenedFile],
        resources: ExitStack,
        unlisted: tuple[Loss, ...] = (),
    ) -> None:
        self._files = files
        self._unlisted = unlisted
        self._resources = resources
        self.paths = tuple(file.path for file in files)
        known = zip(originals, self.paths, strict=True)  # the facts of a file on a server, too
        self.opened = tuple(one if one.stream else OpenedFile(path) for one, path in known)
        self.topics: tuple[TopicInfo, ...] = merge_topics(info for file in files for info in file.topics)
        self.message_count = sum(file.message_count for file in files)
        self.start_ns = min((file.start_ns for file in files if file.message_count), default=0)
        self.end_ns = max((file.end_ns for file in files if file.message_count), default=0)

    def __repr__(self) -> str:
        names, seconds = ", ".join(map(str, self.paths)), (self.end_ns - self.start_ns) / 1e9
        return f"Recording({names}: {self.message_count} messages of {len(self.topics)} topics, {seconds:.3f} s)"

    @property
    def losses(self) -> tuple[Loss, ...]:
        """See `Recording`."""
        return tuple(loss for file in self._files for loss in file.losses) + self._unlisted

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See `Recording`."""
        wanted = None if topics is None else frozenset(topics)
        streams = [self._messages_of(file, wanted, start_ns, stop_ns) for file in self._files]
        return heapq.merge(*streams, key=lambda message: (message.log_time_ns, message.order))

    def _messages_of(
        self, file: RecordingFile, topics: frozenset[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        count = log_time_ns = 0

        def progress() -> str:
            return f"after {count} messages (log time {log_time_ns} ns)" if count else "before the first message"

        with library_errors(file.path, progress=progress):
            for message in file.messages(topics, start_ns=start_ns, stop_ns=stop_ns):
                count, log_time_ns = count + 1, message.log_time_ns
                yield message

    def close(self) -> None:
        """Close the files."""
        self._resources.close()


def _all_files(paths: Sequence[Location]) -> list[Location]:
    files: list[Location] = []
    for path in paths:
        if isinstance(path, RemotePath):
            files.append(path)
            continue
        with library_errors(path):
            if not path.exists():
                raise RecordingError(f"{path}: no such file or folder; expected {EXPECTED}")
            if not path.is_file() and not path.is_dir():  # a pipe would wait for a writer
                raise RecordingError(f"{path}: neither a file nor a folder; expected {EXPECTED}")
            files += recording_files(path) if path.is_dir() else (path,)
    seen: dict[object, Location] = {}
    for file in files:
        identity = file.url if isinstance(file, RemotePath) else _inode(file)
        if identity in seen:
            raise RecordingError(f"{file}: given twice (also as {seen[identity]}); name each file of a recording once")
        seen[identity] = file
    return files


def _unlisted(paths: Sequence[Location], options: ReadOptions) -> tuple[Loss, ...]:
    """Files in the folders of a recording that are not read, because metadata.yaml does not list them.

    Raises:
        RecordingError: there are some, and damage is an error.
    """
    folders = [path for path in paths if isinstance(path, Path) and path.is_dir()]
    files = [file for folder in folders for file in unlisted_files(folder)] if folders else []
    reason = "metadata.yaml does not list this file, so it is not read; name the files to read it, too"
    if files and options.recovery == "none":
        raise RecordingError(f"{files[0]}: {reason}")
    return tuple(Loss(file, 0, reason, file.stat().st_size) for file in files)


def _inode(file: Path) -> tuple[int, int]:
    """Device and inode, which are the same through a link."""
    with library_errors(file):
        status = file.stat()
    return status.st_dev, status.st_ino


def _stream(path: Location, stack: ExitStack) -> BinaryIO | None:
    """The bytes of a local file: what a run reads of it and what it computes the checksum of."""
    if isinstance(path, RemotePath):
        return None
    with library_errors(path):
        return stack.enter_context(path.open("rb"))


def _open_file(original: OpenedFile, index: int, stack: ExitStack, options: ReadOptions) -> RecordingFile:
    """Open one file; the stack closes it and removes temporary copies."""
    path, stream = original.path, original.stream
    is_recovering = options.recovery != "none"
    if isinstance(path, RemotePath):
        from lidcam.readers.files.mcap.mcap_file import McapFile
        from lidcam.readers.files.remote import open_remote

        path, remote = open_remote(path, options.limits)
        stack.callback(remote.close)
        with library_errors(path, is_recovering=is_recovering):
            _check_is_mcap(path, remote)
            return McapFile(Source(path, index, options, Losses(path, options)), remote)
    with library_errors(path, is_recovering=is_recovering):
        assert stream is not None  # only a file on a server has none
        content, losses = path, Losses(path, options)
        magic = _first_bytes(stream)
        if magic.startswith(ZSTD_MAGIC):
            content, stream = unpacked(path, stream, stack, losses, options.limits)
            magic = _first_bytes(stream)
        elif magic.startswith(SQLITE_MAGIC) and (journals := journals_of(path)):
            if is_recovering:
                content, stream = completed(path, stream, journals, stack, losses)
            elif journals[0].name.endswith("-wal"):
                raise RecordingError(
                    f"{path}: the recorder did not close it, part of it is still in {journals[0].name}; "
                    f"`sqlite3 {path.name} 'PRAGMA wal_checkpoint'` in a copy of the folder completes it"
                )
        if magic.startswith(SQLITE_MAGIC) and is_recovering:
            content, stream = whole_pages(content, stream, stack)
        file = _file_of_kind(Source(path, index, options, losses), path, content, stream, magic)
        stack.callback(file.close)
    return file


def _check_is_mcap(path: RemotePath, stream: BinaryIO) -> None:
    """Refuse the other formats on a server: their indexes cannot be fetched at once."""
    magic = _first_bytes(stream)
    if not magic.startswith(MCAP_MAGIC):
        if other := _other_kind(magic):
            raise RecordingError(f"{path}: expected an .mcap file, found {other}")
        kinds = {ROSBAG1_MAGIC: "a ROS 1 bag", SQLITE_MAGIC: "an SQLite database", ZSTD_MAGIC: "a compressed file"}
        kind = next((kind for start, kind in kinds.items() if magic.startswith(start)), "another kind of file")
        raise RecordingError(
            f"{path}: of files on a server, lidcam reads .mcap, found {kind}; download it, and read the copy"
        )


def _file_of_kind(source: Source, path: Path, content: Path, stream: BinaryIO, magic: bytes) -> RecordingFile:
    if magic.startswith(ROSBAG1_MAGIC):
        from lidcam.readers.files.rosbag1.rosbag1_file import Rosbag1File

        return Rosbag1File(source, stream)
    if not magic.startswith((MCAP_MAGIC, SQLITE_MAGIC)):
        from lidcam.readers.files.pcap.packets import is_capture
        from lidcam.readers.files.pcap.pcap_file import PcapFile

        if is_capture(magic):
            return PcapFile(source, stream)
        error = RecordingError if magic else DamageError
        raise error(f"{path}: expected {EXPECTED}, found {_describe(magic, path)}")
    metadata = folder_metadata(path.parent, is_recording=False)
    if path.name in metadata.file_names:
        source = replace(source, metadata=metadata)
    if magic.startswith(MCAP_MAGIC):
        from lidcam.readers.files.mcap.mcap_file import McapFile

        return McapFile(source, stream)
    from lidcam.readers.files.sqlite_file import SqliteFile

    return SqliteFile(source, stream, content)


def _first_bytes(stream: BinaryIO) -> bytes:
    magic = stream.read(512)
    stream.seek(0)
    return magic


def _other_kind(magic: bytes) -> str:
    """The kind of a file that is no recording, and what to do; empty if its first bytes do not say."""
    if magic[8:12] == OSF_MARK:
        return (
            "an Ouster recording (OSF); save it as a .pcap with `ouster-cli source FILE.osf save FILE.pcap`, and read "
            "that, with the JSON that is saved beside it"
        )
    if magic[TAR_MARK_AT:].startswith(b"ustar"):
        return "a tar archive; unpack it with `tar -xf`"
    return next((words for start, words in OTHER_KINDS.items() if magic.startswith(start)), "")


def _describe(magic: bytes, path: Path) -> str:
    """A guess at a file that is not a recording, and what to do."""
    if not magic:
        kind = "a compressed file with nothing in it" if path.suffix == ".zstd" else "an empty file"
        return f"{kind}; record or copy it again"
    if other := _other_kind(magic):
        return other
    if magic.startswith(b"#ROSBAG V"):
        version = magic[9:].split(b"\n")[0].decode(errors="replace")
        return f"a ROS 1 bag of format {version}; convert it with `rosbag fix`"
    if path.suffix in {".bag", ".mcap", ".db3", ".pcap", ".pcapng"}:
        return f"a file that does not begin as a {path.suffix} file; it is damaged or of another format"
    is_text = all(byte >= 32 or byte in b"\t\r\n" for byte in magic)
    return f"a {'text file' if is_text else 'file of another kind'}; name the recording itself"
