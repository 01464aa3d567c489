"""The mcap library's reader, kept from unpacking chunks where none belongs.

The library unpacks every chunk that it meets while it looks for the header or the summary, whatever it unpacks to.
"""

from collections.abc import Iterator
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel as RecordedChannel
from mcap.records import ChunkIndex, Footer, Header, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

__all__ = ["HeadReader"]

FOOTER_AND_MAGIC_BYTES = 29 + 8


class HeadReader(SeekingReader):
    """Reads header and summary of an MCAP file."""

    def get_header(self) -> Header:
        """The header.

        Raises:
            Exception: of the library, where there is none.
        """
        self._stream.seek(0)
        header = next(self._records(skip_magic=False))
        if not isinstance(header, Header):
            raise McapError(f"expected a header, found {type(header).__name__}")
        return header

    def get_summary(self) -> Summary | None:
        """The summary section; None where the file has none.

        Raises:
            Exception: of the library, where it is damaged.
        """
        if self._summary is None:
            self._stream.seek(-FOOTER_AND_MAGIC_BYTES, 2)
            footer = next(self._records())
            if not isinstance(footer, Footer):
                raise McapError(f"expected a footer, found {type(footer).__name__}")
            if footer.summary_start == 0:
                return None
            self._stream.seek(footer.summary_start)
            self._summary = _summary_of(self._records())
        return self._summary

    def _records(self, *, skip_magic: bool = True) -> Iterator[Any]:
        return StreamReader(self._stream, skip_magic=skip_magic, emit_chunks=True).records


def _summary_of(found: Iterator[Any]) -> Summary:
    summary = Summary()
    for record in found:
        if isinstance(record, Statistics):
            summary.statistics = record
        elif isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, RecordedChannel):
            summary.channels[record.id] = record
        elif isinstance(record, ChunkIndex):
            summary.chunk_indexes.append(record)
    return summary
