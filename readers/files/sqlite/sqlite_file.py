"""ROS 2 recordings in SQLite (rosbag2_storage_sqlite3, schema versions 1 to 4).

Read with Python's sqlite3, so that messages of equal time come in the order of their rows, the sort never holds message
data, and an empty serialization format is accepted.
"""

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.files.container import Container, Source
from lidcam.readers.files.copies import count_pages
from lidcam.readers.files.damage import LIBRARY_ERRORS
from lidcam.readers.files.decompress import decompressed
from lidcam.readers.files.passes import pass_starts
from lidcam.readers.files.sqlite.index import contents_of_tables
from lidcam.readers.messages.header_stamp import stamp_or_log_time
from lidcam.readers.recording import RosVersion, TopicInfo, merge_topics

DEFINITION_FORMATS: dict[str, Literal["ros2msg", "ros2idl"]] = {"ros2msg": "ros2msg", "ros2idl": "ros2idl"}

ROWS_AT_ONCE = 4096


class SqliteFile(Container):
    """One open .db3 file; see `RecordingFile`. `content` is where the uncompressed bytes of `stream` lie.

    Raises:
        RecordingError: another file has taken its place since it was opened.
    """

    ros_version: RosVersion = "ROS 2"

    def __init__(self, source: Source, stream: BinaryIO, content: Path) -> None:
        # immutable: no lock and no journal, so that recordings on read-only media open too
        uri = f"{content.resolve().as_uri()}?mode=ro&immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, source.options.limits.max_message_bytes)
        self._database.text_factory = lambda text: text.decode(errors="replace")
        try:
            super().__init__(source, stream)
        except BaseException:
            self._database.close()
            raise

    def _describe(self) -> None:
        distro = self._source.metadata.distro
        with self._losses.guard() as damage:
            pages = count_pages(self._stream)
            if pages.expected > pages.whole:
                raise EOFError(f"the file has {pages.whole} of {pages.expected} pages: it was cut off")
            contents = contents_of_tables(self._database, self.path, distro, self._losses)
        if damage.error:
            because = damage.reason
            contents = contents_of_tables(self._database, self.path, distro, self._losses, because=because)
            if not len(contents.rows):
                raise damage.error
        self._channels: dict[int, Channel] = {}
        topics = []
        ids, numbers = np.unique(contents.rows[:, 2], return_counts=True)
        self._counts: dict[int, int] = dict(zip(ids.tolist(), numbers.tolist(), strict=True))
        for topic_id, topic, recorded_type, encoding in contents.topics:
            msgtype = normalize_msgtype(recorded_type)
            count = self._counts.get(topic_id, 0)
            if encoding not in {"cdr", ""}:
                reason = f"its messages are serialised as {' '.join(encoding.split())[:50]}, lidcam reads cdr"
                topics.append(TopicInfo(topic, msgtype, count, (), reason))
                continue
            form, text = contents.definitions.get(recorded_type, ("", ""))
            known = DEFINITION_FORMATS.get(form)
            digest = contents.type_hashes.get(topic_id) or ""
            channel = Channel(topic, msgtype, "cdr", text if known else "", known or "ros2msg", contents.distro, digest)
            self._channels[topic_id] = channel
            topics.append(TopicInfo(topic, msgtype, count, (channel,)))
        self._rows = self._of_topics(contents.rows, [topic_id for topic_id, *_ in contents.topics])
        if unlisted := len(contents.rows) - len(self._rows):
            self._losses.note(0, "messages of a topic that the file does not list", messages=unlisted)
        self._passes = _passes(self._rows)
        self.topics = merge_topics(topics)
        self.message_count = len(self._rows)
        self.start_ns, self.end_ns = (int(self._rows[i, 0]) if self.message_count else 0 for i in (0, -1))

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = [id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics]
        for rows in self._passes:
            yield from self._messages_of(self._of_topics(rows, wanted), start_ns, stop_ns)

    def _of_topics(self, rows: I64, topic_ids: Collection[int]) -> I64:
        """Rows of some topics, not copied if these are all."""
        if self._counts.keys() <= {*topic_ids}:
            return rows
        return rows[np.isin(rows[:, 2], [*topic_ids])]

    def _messages_of(self, rows: I64, start_ns: int | None, stop_ns: int | None) -> Iterator[RawMessage]:
        """Messages of one pass of the recorder's clock."""
        rows = rows[slice(*(None if t is None else int(np.searchsorted(rows[:, 0], t)) for t in (start_ns, stop_ns)))]
        for first in range(0, len(rows), ROWS_AT_ONCE):
            for log_time_ns, row_id, topic_id in rows[first : first + ROWS_AT_ONCE].tolist():
                channel, data = self._channels[topic_id], self._read_or_note(log_time_ns, row_id)
                if data is not None:
                    order = self._source.index, row_id
                    yield RawMessage(stamp_or_log_time(channel, data, log_time_ns), log_time_ns, order, data, channel)

    def _read_or_note(self, log_time_ns: int, row_id: int) -> bytes | memoryview | None:
        """The bytes of a message; None if they are damaged, which is noted."""
        self._check_open()
        try:
            data = self._read(log_time_ns, row_id)
            if not isinstance(data, bytes):
                raise TypeError(f"message {row_id} has no bytes")
            announced, largest = self._source.metadata.message_compression, self._limits.max_message_bytes
            return decompressed(data, "cdr", announced=announced, largest=largest)
        except LIBRARY_ERRORS as err:
            self._losses.note(0, f"message {row_id}: {self._losses.reason(err)}", messages=1)
            return None

    def _read(self, log_time_ns: int, row_id: int) -> Any:
        try:
            row = self._database.execute("SELECT data, timestamp FROM messages WHERE id = ?", (row_id,)).fetchone()
        except sqlite3.DataError as err:
            raise ValueError(f"more than {self._limits.max_message_bytes} bytes, see limit_scale") from err
        if row is None or row[1] != log_time_ns:
            raise sqlite3.DatabaseError("its id leads to another row, or to none")
        return row[0]

    def close(self) -> None:
        """Close the database."""
        self._database.close()
        super().close()


def _passes(rows: I64) -> list[I64]:
    """The rows of each pass of the recorder's clock, as sorted as all of them; ids rise in the order of writing."""
    if (rows[1:, 1] > rows[:-1, 1]).all():  # log times rise through the file
        return [rows]
    in_file = np.argsort(rows[:, 1])
    starts = pass_starts(rows[in_file, 0], rows[in_file, 2])
    if not starts:
        return [rows]
    return [rows[np.sort(places)] for places in np.split(in_file, starts)]
