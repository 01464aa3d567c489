"""Judges what is read of a damaged recording against what was in it: nothing may be missing or altered in silence."""

import resource
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from sound_recordings import Seen, SoundRecording, read_all

from pipeline.core.errors import LidcamError

__all__ = ["Recovery", "Verdict", "judge"]

Recovery = Literal["none", "as_needed", "full_scan"]

MAX_GROWTH_MIB = 400
MAX_LINE_CHARACTERS = 5000

ONE_COPY = {
    "payload": {
        "rosbag1-none",
        "rosbag1-lz4",  # rosbags writes lz4 frames without a checksum
        "mcap-no-crc",
        "mcap-no-chunks",
        "mcap-no-chunks-no-crc",
        "sqlite",
        "sqlite-old",
        "sqlite-wal",
        "folder-sqlite",
        "folder-sqlite-message",
        "folder-sqlite-file",  # rosbags writes zstd frames without a checksum
        "folder-mcap",  # nor MCAP chunks with one
        "pcap",
        "pcapng",
    },
    "log time": {"mcap-no-chunks-no-crc", "pcap", "pcapng"},
    "definition": {"sqlite", "sqlite-wal", "folder-sqlite", "folder-sqlite-message", "folder-sqlite-file"},
    "name": {"sqlite", "sqlite-old", "sqlite-wal", "pcap", "pcapng"},
}
"""What is written once and without a checksum in a container, so that no reader can tell that it was altered."""


NO_END = {"pcap", "pcapng"}
"""Captures: their files may end after any packet."""


class Verdict(NamedTuple):
    """How the reading of one damaged recording went; `is_fault` if it falls short."""

    kind: str
    is_fault: bool
    detail: str = ""


def judge(sound: SoundRecording, path: Path, recovery: Recovery) -> Verdict:
    """Read `path`, an altered copy of `sound`.

    Raises:
        Exception: what the readers raise and may not.
    """
    before_mib = _peak_mib()
    try:
        messages, losses = read_all(path, recovery)
    except LidcamError as err:
        text = str(err)
        if not text or "\n" in text or len(text) > MAX_LINE_CHARACTERS:
            return Verdict("an error of more than one line", is_fault=True, detail=text)
        return Verdict("refused in one line", is_fault=False, detail=text)
    if _peak_mib() - before_mib > MAX_GROWTH_MIB:
        return Verdict(f"memory: {_peak_mib()} MiB", is_fault=True)
    told = [loss for loss in losses if loss.reason not in sound.told]
    reasons = "; ".join(f"{loss.position}: {loss.reason} ({loss.messages})" for loss in told)
    if any("\n" in loss.reason or loss.position < 0 for loss in told):
        return Verdict("a loss that cannot be told", is_fault=True, detail=reasons)
    if messages == sound.messages:
        return Verdict("equal, told" if told else "equal, nothing said", is_fault=False, detail=reasons)
    difference = _difference(sound.messages, messages)
    text = " and ".join(sorted(difference))
    detail = f"{text}: {len(messages)} of {len(sound.messages)} messages; {_first(sound.messages, messages)}"
    if told:
        unknown = Counter(message.data for message in messages) - Counter(message.data for message in sound.messages)
        more = len(messages) > len(sound.messages)
        altered = bool(unknown) and sound.checked
        kind = " (messages twice or invented)" if more else " (among them altered ones)" if altered else ""
        return Verdict(f"different, told{kind}", is_fault=False, detail=f"{detail}; {reasons}")
    if difference == {"loss"} and sound.kind in NO_END and messages == sound.messages[: len(messages)]:
        return Verdict("cut between two packets, no end in this format", is_fault=False, detail=detail)
    if difference and all(sound.kind in ONE_COPY.get(part, ()) for part in difference):
        return Verdict(f"{text} only, no second copy in this format", is_fault=False, detail=detail)
    return Verdict(f"SILENT: {text}", is_fault=True, detail=detail)


def _difference(expected: Sequence[Seen], found: Sequence[Seen]) -> set[str]:
    """In what two recordings differ; `loss` where messages are missing."""
    if len(found) < len(expected):
        return {"loss"}
    if len(found) > len(expected):
        return {"more messages"}
    differs: set[str] = set()
    names = Counter(message.name for message in expected) != Counter(message.name for message in found)
    for one, other in _pairs(expected, found):
        if one.name != other.name:
            differs.add("name")
        elif one.definition != other.definition:
            differs.add("definition")
        if one.log_time_ns != other.log_time_ns:
            differs.add("log time")
        if one.data != other.data:
            differs.add("payload")
    if names:
        differs.add("name")
    return differs or {"order"}


def _pairs(expected: Sequence[Seen], found: Sequence[Seen]) -> list[tuple[Seen, Seen]]:
    """Equal messages with one another, then the rest in their order."""
    left, right = Counter(expected), Counter(found)
    rest = [message for message in expected if not _taken(right, message)]
    others = [message for message in found if not _taken(left, message)]
    if len({m.data for m in rest}) == len(rest) and {m.data for m in rest} == {m.data for m in others}:
        by_data = {message.data: message for message in others}
        return [(message, by_data[message.data]) for message in rest]
    return list(zip(rest, others, strict=True))


def _taken(counts: Counter[Seen], message: Seen) -> bool:
    counts[message] -= 1
    return counts[message] >= 0


def _first(expected: Sequence[Seen], found: Sequence[Seen]) -> str:
    for number, (one, other) in enumerate(zip(expected, found, strict=False)):
        if one != other:
            return f"message {number}: {_short(one)} became {_short(other)}"
    return f"{_short(expected[len(found)]) if len(found) < len(expected) else 'more'}"


def _short(message: Seen) -> str:
    return f"{message.name} {message.log_time_ns} ({len(message.data)} bytes, {hash(message.data) & 0xFFFF:04x})"


def _peak_mib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
