"""Schemas and channels of an MCAP file, which are written several times: in chunks, outside of them, in the summary.

Chunks and summary have checksums that a writer may leave out. Where two records differ, the one under a checksum is
used, else the first one, and the difference is told: a changed bit would rename a topic.
"""

from collections.abc import Mapping
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from readers.files.damage import Losses

__all__ = ["Definitions"]


class Definitions:
    """What is known of schemas and channels.

    Args:
        losses: Is told what differs.

    Attributes:
        schemas: By id.
        channels: By id.
    """

    def __init__(self, losses: Losses) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._losses = losses
        self._checked: set[tuple[int, int]] = set()
        self._seen: set[int] = set()

    def know(self, schemas: Mapping[int, Schema], channels: Mapping[int, Channel], *, is_checked: bool) -> None:
        """Take what others have read."""
        self.schemas.update(schemas)
        self.channels.update(channels)
        if is_checked:
            self._checked |= {(int(Opcode.SCHEMA), id_) for id_ in schemas}
            self._checked |= {(int(Opcode.CHANNEL), id_) for id_ in channels}

    def add(self, opcode: int, record: bytes, position: int, *, is_checked: bool) -> None:
        """Add a schema or channel, or compare it with the one that is known.

        Args:
            opcode: Which of the two; anything else is ignored.
            record: Its content.
            position: Byte of the file at which it, or its chunk, begins.
            is_checked: Whether it was under a checksum that is right.

        Raises:
            Exception: any that damage causes.
        """
        if opcode not in {Opcode.SCHEMA, Opcode.CHANNEL} or hash((opcode, record, is_checked)) in self._seen:
            return
        stream = ReadDataStream(BytesIO(record))
        added = Schema.read(stream) if opcode == Opcode.SCHEMA else Channel.read(stream)
        known = (self.schemas if isinstance(added, Schema) else self.channels).get(added.id)
        key = opcode, added.id
        if known is None or (is_checked and key not in self._checked):
            if isinstance(added, Schema):
                self.schemas[added.id] = added
            else:
                self.channels[added.id] = added
        if is_checked:
            self._checked.add(key)
        self._seen.add(hash((opcode, record, is_checked)))
        if known is not None and known != added:
            self._note(known, added, position)

    def _note(self, known: Schema | Channel, added: Schema | Channel, position: int) -> None:
        names = [one.name if isinstance(one, Schema) else one.topic for one in (known, added)]
        kind = "schema" if isinstance(known, Schema) else "channel"
        used = (self.schemas if isinstance(known, Schema) else self.channels)[known.id]
        which = "this one" if used is added else "the other one"
        self._losses.note(
            position,
            f"{kind} {known.id} ({_short(names[1])}) is another one here than elsewhere in the file "
            f"({_short(names[0])}); {which} is used",
            messages=0,
        )


def _short(name: str) -> str:
    return repr(name if len(name) <= 100 else name[:97] + "...")
