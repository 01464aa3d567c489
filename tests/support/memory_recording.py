"""Recordings in memory."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.input_file import OpenedFile
from lidcam.readers.recording import Closing, Loss, TopicInfo, merge_topics


class MemoryRecording(Closing):
    """The given messages as a `Recording`, in the order of (log time, place in `messages`)."""

    paths: tuple[Path, ...] = ()
    opened: tuple[OpenedFile, ...] = ()
    losses: tuple[Loss, ...] = ()

    def __init__(self, messages: Iterable[RawMessage]) -> None:
        placed = [message._replace(order=(0, place)) for place, message in enumerate(messages)]
        self._messages = sorted(placed, key=lambda message: (message.log_time_ns, message.order))
        counts = Counter(message.channel for message in placed)
        self.topics: tuple[TopicInfo, ...] = merge_topics(
            TopicInfo(channel.topic, channel.msgtype, count, (channel,)) for channel, count in counts.items()
        )
        self.message_count = len(placed)
        self.start_ns = self._messages[0].log_time_ns if placed else 0
        self.end_ns = self._messages[-1].log_time_ns if placed else 0

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See `Recording`."""
        for message in self._messages:
            if topics is not None and message.topic not in topics:
                continue
            if start_ns is not None and message.log_time_ns < start_ns:
                continue
            if stop_ns is not None and message.log_time_ns >= stop_ns:
                return
            yield message

    def close(self) -> None:
        """Nothing to close."""
