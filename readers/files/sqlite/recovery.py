"""The rows of a damaged SQLite recording, read page by page without SQLite's own trees.

The library refuses a database that lacks a page, and does not contain the command line tool's `.recover`. The pages
suffice (https://www.sqlite.org/fileformat2.html): every leaf of a table contains whole rows, and a long row names the
page on which it continues. They have no checksums, so overwritten bytes of a message go unnoticed.
"""

import struct
from array import array
from collections import deque
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from pipeline.core.arrays import I64
from readers.files.damage import Losses
from readers.files.sqlite.index import Contents, text_of

__all__ = ["check_size", "contents_of_scan", "read_message"]

LEAF = 0x0D
HEADER_BYTES = 100
MAX_PAYLOAD = 1 << 30
STEPS_PER_PAGE = 4
"""How often an overflow page may be visited: once, and again by the remains of deleted rows."""
INTEGER_BYTES = (0, 1, 2, 3, 4, 6, 8)
UINT32 = struct.Struct(">I")

Value = int | float | str | bytes | None


class _Pages:
    """The pages of a database file by number, from 1."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        file_bytes = stream.seek(0, 2)
        stream.seek(0)
        header = stream.read(HEADER_BYTES)
        if len(header) < HEADER_BYTES:
            raise EOFError(f"expected {HEADER_BYTES} bytes of a database's header, found {len(header)}")
        (size,) = struct.unpack_from(">H", header, 16)
        self.size = 65536 if size == 1 else int(size)
        if self.size < 512 or self.size & (self.size - 1):
            raise ValueError(f"expected a power of two as the size of pages, found {self.size}")
        self.usable = self.size - header[20]
        if self.usable < 480:
            raise ValueError(f"expected at least 480 usable bytes in a page, found {self.usable}")
        self.count = file_bytes // self.size
        counted, valid_for, changes = (UINT32.unpack_from(header, place)[0] for place in (28, 92, 24))
        self._steps_left = STEPS_PER_PAGE * self.count
        self.expected: int = counted if valid_for == changes else 0  # else an old SQLite, which did not count pages

    def read(self, number: int, size: int | None = None) -> bytes:
        """One page, or its first `size` bytes.

        Raises:
            ValueError: the file has no such page.
        """
        if not 1 <= number <= self.count:
            raise ValueError(f"page {number} of {self.count} is missing")
        self._stream.seek((number - 1) * self.size)
        return self._stream.read(self.size if size is None else size)

    def overflow(self, cell: "_Cell", size: int | None = None) -> Iterator[bytes]:
        """The overflow pages of a row, or the first `size` bytes of each.

        Raises:
            ValueError: one is missing, the row does not end where its size says, or too many were read.
        """
        length = -(-(cell.payload_size - len(cell.local)) // (self.usable - 4))
        if length > self.count:
            raise ValueError(f"a row of {cell.payload_size} bytes is larger than the file")
        number = cell.overflow
        for _ in range(length):
            if not self._steps_left:
                raise ValueError("rows with too many overflow pages")
            self._steps_left -= 1
            page = self.read(number, size)
            (number,) = UINT32.unpack_from(page)
            yield page
        if number:
            raise ValueError("a row that continues after its end")


class _Cell(NamedTuple):
    """A row in a leaf: `local` is the part of its payload in the leaf, the rest begins on page `overflow`."""

    row_id: int
    payload_size: int
    local: bytes
    overflow: int


def check_size(stream: BinaryIO) -> None:
    """Refuse a file that lacks pages: SQLite would read the missing rest of its last page as zeros.

    Raises:
        EOFError: pages are missing.
        ValueError: its header is not that of a database.
    """
    pages = _Pages(stream)
    if pages.expected > pages.count:
        raise EOFError(f"the file has {pages.count} of {pages.expected} pages")


def contents_of_scan(stream: BinaryIO, losses: Losses, *, because: str, listed: int | None = None) -> Contents:
    """The contents, found by reading every page once.

    Args:
        stream: The file.
        losses: Collects what is damaged.
        because: Why SQLite cannot read the file; noted if no other damage is found.
        listed: Number of messages that an index counts; else the gaps between ids tell what is missing.

    Raises:
        ValueError: its header is not that of a database.
        EOFError: the file ends inside its header.
    """
    pages = _Pages(stream)
    rows = array("q")
    topics: dict[int, tuple[int, str, str, str]] = {}
    definitions: dict[str, tuple[str, str]] = {}
    distro = ""
    broken: list[int] = []
    for number in range(1, pages.count + 1):
        page = pages.read(number)
        left = pages.size
        for place in _places(page, HEADER_BYTES if number == 1 else 0):
            try:
                cell = _cell(page, place, pages.usable)
                left -= len(cell.local)
                if left < 0:
                    raise ValueError("rows that overlap")  # noqa: TRY301  (noted like other damage)
                types = _serial_types(cell.local)
                if _is_message(types):
                    deque(pages.overflow(cell, UINT32.size), maxlen=0)
                    _, topic_id, log_time_ns = _values(cell.local, types[:3])
                    rows.extend((_integer(log_time_ns), cell.row_id, _integer(topic_id), number, place))
                    continue
                if not types or types[0] or not all(type_ >= 12 for type_ in types[1:]):
                    continue
                texts = [text_of(value) for value in _values(_payload(pages, cell), types)[1:]]
            except (ValueError, LookupError, struct.error):
                broken.append((number - 1) * pages.size + place)
                continue
            if len(texts) == 1:
                distro = distro or texts[0]
            elif len(texts) >= 3 and texts[1] in {"ros2msg", "ros2idl", "unknown"}:
                definitions.setdefault(texts[0], (texts[1], texts[2]))
            elif len(texts) >= 3 and "\n" not in texts[2]:  # else a definition whose encoding is damaged
                topics.setdefault(cell.row_id, (cell.row_id, texts[0], texts[1], texts[2]))
    table = np.array(rows, np.int64).reshape(-1, 5)
    table = table[np.unique(table[:, 1], return_index=True)[1]]  # freed pages may still contain old rows
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    _note(pages, _missing(table[:, 1], listed), broken, losses, because)
    return Contents(distro, definitions, table, [topics[id_] for id_ in sorted(topics)], {})


def read_message(stream: BinaryIO, page: int, place: int) -> bytes:
    """The data of the message in the row at `place` of `page`.

    Raises:
        ValueError: the row or one of its overflow pages is damaged.
    """
    pages = _Pages(stream)
    payload = _payload(pages, _cell(pages.read(page), place, pages.usable))
    data = _values(payload, _serial_types(payload))[3]
    if not isinstance(data, bytes):
        raise TypeError("a message without bytes")
    return data


def _missing(ids: I64, listed: int | None) -> int:
    """Number of messages that are nowhere."""
    if listed is not None:
        return listed - len(ids)
    return int(ids.max()) - int(ids.min()) + 1 - len(ids) if len(ids) else 0


def _note(pages: _Pages, missing: int, broken: list[int], losses: Losses, because: str) -> None:
    end = pages.count * pages.size
    is_cut = pages.expected > pages.count
    if is_cut:
        size = (pages.expected - pages.count) * pages.size
        losses.note(end, f"the file has {pages.count} of {pages.expected} pages: it was cut off", size=size)
    if broken:
        reason = f"{len(broken)} rows that cannot be read, or whose data lie on missing pages"
        losses.note(broken[0], reason, messages=max(missing, 0) if len(broken) <= missing else None)
    elif missing:
        losses.note(0, f"the ids of the messages show that {missing} are missing ({because})", messages=missing)
    elif not is_cut:
        losses.note(0, f"SQLite cannot read it ({because}); the rows were found by reading every page", messages=0)


def _places(page: bytes, offset: int) -> list[int]:
    """Where the rows of a leaf are; empty if the page is not a leaf."""
    if page[offset] != LEAF:
        return []
    (count,) = struct.unpack_from(">H", page, offset + 3)
    end = min(offset + 8 + 2 * count, len(page) - 1)
    places: list[int] = np.frombuffer(page[offset + 8 : end], ">u2", count=(end - offset - 8) // 2).tolist()
    return places


def _cell(page: bytes, place: int, usable: int) -> _Cell:
    size, at = _varint(page, place)
    row_id, at = _varint(page, at)
    if size > MAX_PAYLOAD:
        raise ValueError(f"a row of {size} bytes")
    max_local = usable - 35
    local = size
    if size > max_local:
        min_local = (usable - 12) * 32 // 255 - 23
        local = min_local + (size - min_local) % (usable - 4)
        local = local if local <= max_local else min_local
    if at + local + (4 if local < size else 0) > usable:
        raise ValueError("a row that reaches beyond its page")
    overflow = UINT32.unpack_from(page, at + local)[0] if local < size else 0
    return _Cell(row_id, size, page[at : at + local], overflow)


def _payload(pages: _Pages, cell: _Cell) -> bytes:
    parts = [cell.local, *(page[4 : pages.usable] for page in pages.overflow(cell))]
    return b"".join(parts)[: cell.payload_size]


def _serial_types(payload: bytes) -> list[int]:
    """The serial type of each column of a row."""
    end, at = _varint(payload, 0)
    if end > len(payload):
        raise ValueError("a row whose header reaches beyond it")
    types = []
    while at < end:
        type_, at = _varint(payload, at)
        types.append(type_)
    return types


def _is_message(types: list[int]) -> bool:
    """Whether the columns are id (stored apart, so null), topic_id, timestamp and data."""
    integers = {1, 2, 3, 4, 5, 6, 8, 9}
    return len(types) == 4 and types[0] == 0 and {*types[1:3]} <= integers and types[3] >= 12 and types[3] % 2 == 0


def _values(payload: bytes, types: list[int]) -> list[Value]:
    """The first columns of a row.

    Raises:
        ValueError: they reach beyond it.
    """
    at, _ = _varint(payload, 0)
    values: list[Value] = []
    for type_ in types:
        if type_ in {0, 8, 9}:
            values.append({0: None, 8: 0, 9: 1}[type_])
            continue
        size = INTEGER_BYTES[type_] if type_ <= 6 else 8 if type_ == 7 else (type_ - 12) // 2
        content = payload[at : at + size]
        if len(content) != size or type_ in {10, 11}:
            raise ValueError("a row whose columns do not fit it")
        at += size
        if type_ <= 6:
            values.append(int.from_bytes(content, "big", signed=True))
        elif type_ == 7:
            values.append(float(struct.unpack(">d", content)[0]))
        else:
            values.append(content.decode(errors="replace") if type_ % 2 else content)
    return values


def _integer(value: Value) -> int:
    if not isinstance(value, int):
        raise TypeError(f"expected an integer, found {value!r}")
    return value


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """An integer of up to nine bytes of seven bits each, and where it ends."""
    value = 0
    for place in range(8):
        byte = data[at + place]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + place + 1
    value = value << 8 | data[at + 8]
    return (value - (1 << 64) if value >= 1 << 63 else value), at + 9
