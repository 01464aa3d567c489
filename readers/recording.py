"""A recording as the rest of lidcam sees it, whatever its file format."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Protocol, Self

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.input_file import OpenedFile
from lidcam.readers.location import Location

RosVersion = Literal["ROS 1", "ROS 2", "no ROS"]


class ReadOptions(NamedTuple):
    """Options of reading a recording."""

    # Treatment of damage. `none`: an error. `as_needed`: what can be read of a damaged file is read, and
    # `Recording.losses` lists the rest. `full_scan`: the same, but every record is read once even if index or summary
    # seem valid, which finds messages that these do not list
    recovery: Literal["none", "as_needed", "full_scan"] = "as_needed"
    limits: RecordingLimits = DEFAULT_LIMITS  # Memory and disk space that the recording may use


DEFAULT_READ_OPTIONS = ReadOptions()


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic with one type; a topic that was recorded with two types has two of these."""

    topic: str  # Topic name
    msgtype: str  # Type name in the ROS 2 spelling, for instance `sensor_msgs/msg/PointCloud2`
    message_count: int  # Messages recorded, including those that cannot be read
    channels: tuple[Channel, ...]  # The distinct definitions it was recorded with; empty if it cannot be read
    unreadable: str = ""  # Why its messages are not yielded; empty if they are
    part_of: str = ""  # Topic of the combined messages that contain its messages; empty if it was recorded by itself
    # Type of the recorded messages (counted by `message_count`) that its messages are put together from; empty if they
    # are as recorded
    gathered_from: str = ""

    @property
    def channel(self) -> Channel:
        """The first of `channels`; raises RecordingError if the topic cannot be read."""
        if not self.channels:
            raise RecordingError(f"{self.topic}: {self.msgtype} cannot be read: {self.unreadable}")
        return self.channels[0]


@dataclass(frozen=True, slots=True)
class Loss:
    """Part of a file that could not be read.

    Attributes:
        path: The file.
        position: Byte at which it begins; for a file that is compressed as a whole, byte of the unpacked content.
        reason: The expected and the found content.
        size: Its size in the file, in bytes; None if unknown.
        messages: Number of messages lost with it; None if unknown.
    """

    path: Location
    position: int
    reason: str
    size: int | None = None
    messages: int | None = None


class _Contents(Protocol):
    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """Topics, sorted by name and type."""

    @property
    def start_ns(self) -> int:
        """Log time of the first message; 0 if there is none."""

    @property
    def end_ns(self) -> int:
        """Log time of the last message (inclusive); 0 if there is none."""

    @property
    def message_count(self) -> int:
        """Number of messages, including those that cannot be read."""

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The damage that was found, by file and position: reading on may find more."""

    def close(self) -> None:
        """Close the files; messages already yielded stay valid."""


class RecordingFile(_Contents, Protocol):
    """One open file of a recording."""

    @property
    def path(self) -> Location:
        """The file."""

    @property
    def ros_version(self) -> RosVersion:
        """Which ROS recorded it."""

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """As `Recording.messages`, in the order of (pass, see `passes`; log time; position in the file).

        Raises:
            Exception: any that the library raises, if the file is damaged and `ReadOptions.recovery` is `none`.
        """


class Recording(_Contents, Protocol):
    """An open recording: a context manager that closes its files."""

    @property
    def paths(self) -> tuple[Location, ...]:
        """Files, in the order of `RawMessage.order[0]`."""

    @property
    def opened(self) -> tuple[OpenedFile, ...]:
        """The files as they were opened, for their checksums."""

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """The messages of some or all topics, log times from `start_ns` to before `stop_ns`, read lazily.

        They come in the order of (log time, file, position in the file).

        Raises:
            RecordingError: the recording is damaged and `ReadOptions.recovery` is `none`; says how far it was read.
        """

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


class Closing(ABC):
    """A context manager that closes itself."""

    @abstractmethod
    def close(self) -> None:
        """Close it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def merge_topics(topics: Iterable[TopicInfo]) -> tuple[TopicInfo, ...]:
    """One entry per topic and type, sorted; counts are added up, definitions not repeated."""
    merged: dict[tuple[str, str], TopicInfo] = {}
    for info in topics:
        known = merged.get((info.topic, info.msgtype), replace(info, message_count=0, channels=()))
        merged[info.topic, info.msgtype] = replace(
            known,
            message_count=known.message_count + info.message_count,
            channels=tuple(dict.fromkeys(known.channels + info.channels)),
            unreadable=known.unreadable or info.unreadable,
        )
    return tuple(merged[key] for key in sorted(merged))
