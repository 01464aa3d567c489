"""Connections of a ROS 1 bag: which topic and type the messages with a number have.

Each is written twice, in the chunk where it begins and at the end of the file, and only a compressed chunk may have a
checksum. A changed bit in one of them would rename a topic, so both are compared.
"""

from io import BytesIO
from typing import BinaryIO, NamedTuple

from rosbags.rosbag1.reader import Header, normalize
from rosbags.typesys.msg import normalize_msgtype

from pipeline.core.messages import Channel
from readers.files.damage import Losses
from readers.files.rosbag1.records import Record
from readers.messages.deserialize import definition_problem

__all__ = ["Connection", "agreed", "connection_of", "is_same"]


class Connection(NamedTuple):
    """One record of a connection.

    Attributes:
        channel: What it says.
        published_as: The topic's name in the publisher's own words, mostly the same.
        digest: Of the bytes of the record.
    """

    channel: Channel
    published_as: str
    digest: int


def connection_of(stream: BinaryIO, record: Record) -> Connection:
    """What a record of a connection says.

    Raises:
        Exception: any that damage causes.
    """
    content = _content(stream, record)
    fields = Header.read(BytesIO(content))
    topic = normalize(record.fields[b"topic"].decode())
    msgtype = normalize_msgtype(fields.get_string("type"))
    definition, digest = fields.get_string("message_definition"), fields.get_string("md5sum")
    published_as = normalize(fields.get_string("topic")) if fields.get("topic") else topic
    channel = Channel(topic, msgtype, "ros1", definition, "ros1msg", digest=digest)
    return Connection(channel, published_as, hash((record.fields[b"topic"], content)))


def is_same(connection: Connection, stream: BinaryIO, record: Record) -> bool:
    """Whether a record has the same bytes as the one that `connection` was read from."""
    return connection.digest == hash((record.fields[b"topic"], _content(stream, record)))


def _content(stream: BinaryIO, record: Record) -> bytes:
    """The data of a record and their length, which have the form of a header."""
    stream.seek(record.data - 4)
    return stream.read(record.size + 4)


def agreed(
    known: Connection, other: Connection, losses: Losses, *, id_: int, known_at: str, other_at: str, position: int
) -> Connection:
    """One of two records of a connection: the one that is consistent in itself, else the other one.

    Args:
        known: The one that was found first.
        other: The other one.
        losses: Is told that they differ.
        id_: The connection's number.
        known_at: Where `known` is.
        other_at: Where `other` is.
        position: Byte of the file at which the difference is told.
    """
    if known.channel == other.channel:
        return known
    differences = [
        f"{name} {_short(one)} and {_short(two)}"
        for name, one, two in (
            ("topic", known.channel.topic, other.channel.topic),
            ("type", known.channel.msgtype, other.channel.msgtype),
            ("md5sum", known.channel.digest, other.channel.digest),
        )
        if one != two
    ]
    taken, place = (known, known_at) if _doubts(known) < _doubts(other) else (other, other_at)
    losses.note(
        position,
        f"connection {id_} ({taken.channel.topic}) is not the same {known_at} and {other_at}: "
        f"{', '.join(differences) or 'the definitions differ'}; the record {place} is used",
        messages=0,
    )
    return taken


def _doubts(connection: Connection) -> int:
    """How many things in a record contradict one another."""
    channel = connection.channel
    return (
        (connection.published_as != channel.topic)
        + bool(definition_problem(channel))
        + (not channel.topic.isprintable())
    )


def _short(text: str) -> str:
    return repr(text if len(text) <= 100 else text[:97] + "...")
