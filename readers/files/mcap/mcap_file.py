"""MCAP recordings (https://mcap.dev/spec), ROS 2 (cdr) and ROS 1, with chunks (uncompressed, lz4 or zstd) or without.

The mcap library parses the summary. Messages are ordered here: the library's own queue holds every message of all
chunks that overlap in time, and it reads a file without chunk index into memory as a whole.
"""

import numpy as np
from mcap.opcode import Opcode

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.messages import Channel
from lidcam.readers.files.chunked import ChunkedFile, ChunkPlace, Entry
from lidcam.readers.files.container import read_exactly
from lidcam.readers.files.mcap.channels import channel_of, message_type
from lidcam.readers.files.mcap.index import Contents, contents_of_summary, read_profile
from lidcam.readers.files.mcap.records import INDEX_HEAD, PAIR_BYTES, RECORD_HEAD, entry_of, load_chunk, records_in
from lidcam.readers.files.mcap.recovery import contents_of_scan
from lidcam.readers.files.remote import warn_of_full_read
from lidcam.readers.recording import RosVersion, TopicInfo, merge_topics


class McapFile(ChunkedFile):
    """One open MCAP file; see `RecordingFile`."""

    ros_version: RosVersion

    def _describe(self) -> None:
        profile, contents, is_scanned = self._read_contents()
        self._sizes = {place.position: place.size for place in contents.chunks}
        channels: dict[int, Channel] = {}
        topics = []
        for id_, recorded in sorted(contents.channels.items()):
            schema = contents.schemas.get(recorded.schema_id)
            channel = channel_of(recorded, schema, self._source.metadata.distro)
            count = contents.counts[id_]
            if isinstance(channel, str):
                topics.append(TopicInfo(recorded.topic, message_type(schema), count, (), channel))
                continue
            channels[id_] = channel
            topics.append(TopicInfo(recorded.topic, channel.msgtype, count, (channel,)))
        known_ids = None if is_scanned else contents.channels
        self._set_contents(contents.chunks, contents.loose, channels, known_ids)
        self.topics = merge_topics(topics)
        self.message_count = contents.counts.total()
        self.start_ns, self.end_ns = (contents.start_ns, contents.end_ns) if self.message_count else (0, 0)
        encodings = {channel.encoding for channel in channels.values()}
        self.ros_version = "ROS 1" if profile == "ros1" or encodings == {"ros1"} else "ROS 2"

    def _read_contents(self) -> tuple[str, Contents, bool]:
        """Profile, contents, and whether these are not from the summary but from a scan."""
        profile, summary = "", None
        with self._losses.guard() as damage:
            profile = read_profile(self._stream)
            summary = contents_of_summary(self._stream)
        if summary is not None and self._source.options.recovery != "full_scan":
            return profile, summary, False
        because = "every record is wanted"
        if damage.error or summary is None:
            because = f"its summary cannot be used ({damage.reason or 'it does not say all that is in the file'})"
        warn_of_full_read(self._stream, because)
        scanned = contents_of_scan(self._stream, self._losses, because=damage.reason, limits=self._limits)
        if summary is None and not scanned.counts and (damage.error or self.losses):
            raise damage.error or EOFError(self.losses[0].reason)
        return profile, scanned, True

    def _load(self, position: int) -> bytes:
        return load_chunk(self._stream, position, self._limits, size=self._sizes[position])

    def _entries_in(self, position: int, records: bytes) -> list[Entry]:
        found = records_in(records, self._limits)
        return [entry_of(records, at, position, at, size) for opcode, at, size in found if opcode == Opcode.MESSAGE]

    def _indexed(self, place: ChunkPlace) -> I64:
        """From the index records that follow the chunk; none without them."""
        found = [np.zeros((0, 4), np.int64)]
        self._stream.seek(place.position + place.size)
        while True:
            opcode, size = RECORD_HEAD.unpack(read_exactly(self._stream, RECORD_HEAD.size))
            if opcode != Opcode.MESSAGE_INDEX:
                return np.concatenate(found)
            content = read_exactly(self._stream, size)
            channel_id, pair_bytes = INDEX_HEAD.unpack_from(content)
            pairs = np.frombuffer(content, "<u8", pair_bytes // PAIR_BYTES * 2, INDEX_HEAD.size).reshape(-1, 2)
            columns = np.full(len(pairs), place.position), pairs[:, 1], pairs[:, 0], np.full(len(pairs), channel_id)
            found.append(np.stack([column.astype(np.int64) for column in columns], axis=1))
