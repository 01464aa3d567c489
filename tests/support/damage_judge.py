"""Alters recordings, and judges what is read of them against what was in them.

Nothing may be missing in silence, and nothing altered that a checksum covers.
"""

import resource
from collections import Counter
from collections.abc import Sequence
from functools import cache
from itertools import zip_longest
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import NamedTuple

from sound_recordings import CHECKED, KINDS, Recovery, Seen, SoundRecording, read_all, sound_recording, write_files

from lidcam.pipeline.core.errors import LidcamError

SECTOR = 512
MAX_GROWTH_MIB = 400
MAX_LINE_CHARACTERS = 5000
WAL_PAGE_END = 32 + 24 + 4096
"""A write-ahead log that ends before its first page does says nothing, whatever its bytes are: headers and page."""

ALL = frozenset(Seen._fields)
UNCHECKED = {
    **dict.fromkeys(("rosbag1-none", "rosbag1-lz4"), ALL),  # rosbags writes lz4 frames without a checksum
    "rosbag1-bz2": {"definition", "name"},  # those in the index at the end of the file
    **dict.fromkeys(("mcap-no-crc", "mcap-no-chunks", "mcap-no-chunks-no-crc"), ALL),
    **dict.fromkeys(("sqlite", "sqlite-old", "sqlite-wal"), ALL),
    **dict.fromkeys(("folder-sqlite", "folder-sqlite-message", "folder-sqlite-file", "folder-mcap"), ALL),
    "pcap": ALL,
    "pcapng": ALL | {"loss"},  # blocks of kinds that nobody knows yet are passed over
}
"""What no checksum covers in a container, so that a reader that believes an index cannot tell that it was altered."""

NO_END = {"pcap", "pcapng"}
"""Captures: their files may end after any packet."""


class Verdict(NamedTuple):
    """How the reading of one damaged recording went; `is_fault` if it falls short."""

    kind: str
    is_fault: bool
    detail: str = ""


_sound = cache(sound_recording)


def judge_altered(kind: str, chance: Random) -> tuple[Verdict, dict[str, bytes]]:
    """Alter a recording of a kind at random, and read it."""
    sound = _sound(kind)
    recovery: Recovery = chance.choice(("as_needed", "as_needed", "as_needed", "full_scan", "none"))
    name = chance.choice(sorted(sound.files))
    content, how = altered(sound.files[name], chance)
    files = {**sound.files, name: content}
    with TemporaryDirectory(prefix="lidcam-damage-") as folder:
        verdict = judge(sound, write_files(Path(folder), sound, files), recovery)
    is_cut = sound.files[name].startswith(content) or len(content) < WAL_PAGE_END
    if verdict.is_fault and name.endswith("-wal") and is_cut:
        verdict = Verdict("fewer commits of a write-ahead log that was cut, told as not closed", is_fault=False)
    said = f"{verdict.kind} [{kind}]" if verdict.is_fault else verdict.kind
    return Verdict(said, verdict.is_fault, f"{kind}, {recovery}, {name}: {how}: {verdict.detail}"), files


def judge(sound: SoundRecording, path: Path, recovery: Recovery) -> Verdict:
    """Read `path`, an altered copy of `sound`."""
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
        altered = bool(unknown) and sound.kind in CHECKED
        kind = " (messages twice or invented)" if more else " (among them altered ones)" if altered else ""
        return Verdict(f"different, told{kind}", is_fault=False, detail=f"{detail}; {reasons}")
    if difference == {"loss"} and sound.kind in NO_END and messages == sound.messages[: len(messages)]:
        return Verdict("cut between two packets, no end in this format", is_fault=False, detail=detail)
    if difference <= UNCHECKED.get(sound.kind, frozenset()):
        return Verdict("altered where no checksum is", is_fault=False, detail=detail)
    return Verdict(f"SILENT: {text}", is_fault=True, detail=detail)


def _difference(expected: Sequence[Seen], found: Sequence[Seen]) -> set[str]:
    """In what two recordings differ; `loss` where messages are missing."""
    if len(found) != len(expected):
        return {"loss" if len(found) < len(expected) else "more messages"}
    columns = zip(Seen._fields, zip(*expected, strict=True), zip(*found, strict=True), strict=True)
    return {name for name, one, other in columns if Counter(one) != Counter(other)} or {"data"}  # of each other


def _first(expected: Sequence[Seen], found: Sequence[Seen]) -> str:
    pairs = enumerate(zip_longest(expected, found))
    return next(f"message {number}: {one} became {other}"[:300] for number, (one, other) in pairs if one != other)


def _peak_mib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def altered(content: bytes, chance: Random) -> tuple[bytes, str]:
    """A file with one to three alterations, mostly one, and what they are."""
    said = []
    for _ in range(chance.choice((1, 1, 1, 1, 2, 3))):
        how = chance.choice(ALTERATIONS) if content else "inserted"
        before = content
        content = _changed(how, content, chance)
        first = next((i for i, (a, b) in enumerate(zip(before, content, strict=False)) if a != b), len(content))
        said.append(f"{how} at {first}")
    return content, ", ".join(said)


def _changed(how: str, content: bytes, chance: Random) -> bytes:
    at, (start, end) = _place(content, chance), _range(content, chance)
    match how:
        case "bit":
            return content[:at] + bytes([content[at] ^ 1 << chance.randrange(8)]) + content[at + 1 :]
        case "byte":
            return (
                content[:at] + bytes([chance.choice((0, 0xFF, 0x7F, 0x80, chance.randrange(256)))]) + content[at + 1 :]
            )
        case "few bytes":
            return content[:at] + chance.randbytes(len(content[at : at + 8])) + content[at + 8 :]
        case "number":  # one beside which a size or an offset overflows
            size = chance.choice((1, 2, 4, 8))
            number = (1 << chance.randrange(8 * size)) - chance.randrange(2)
            return content[:at] + number.to_bytes(size, chance.choice(("little", "big"))) + content[at + size :]
        case "cut":
            return content[:at]
        case "zeros":
            return content[:start] + bytes(end - start) + content[end:]
        case "swapped":
            size = SECTOR * chance.choice((1, 2, 8))
            a, b = (chance.randrange(max(len(content) // size, 1)) * size for _ in range(2))
            altered = bytearray(content)
            altered[a : a + size], altered[b : b + size] = content[b : b + size], content[a : a + size]
            return bytes(altered)
        case "repeated":
            return content[:end] + content[start:]
        case "removed":
            return content[:start] + content[end:]
        case "inserted":
            return content[:at] + chance.randbytes(chance.choice((1, 4, 100))) + content[at:]
    source = chance.choice([*_sound(chance.choice(KINDS)).files.values()])
    start, end = _range(source, chance)
    return content[:at] + source[start:end] + content[at + end - start :]


ALTERATIONS = (
    *("bit", "number") * 3,
    *("byte", "few bytes", "cut", "zeros", "swapped", "repeated", "removed", "inserted", "piece of another"),
)


def _place(content: bytes, chance: Random) -> int:
    """A byte; every third time one of the first or last kilobyte, where headers and summaries are."""
    size = max(len(content), 1)
    if chance.randrange(3):
        return chance.randrange(size)
    at = chance.randrange(min(size, 1024))
    return chance.choice((at, size - 1 - at))


def _range(content: bytes, chance: Random) -> tuple[int, int]:
    """A few bytes, or whole sectors."""
    if chance.randrange(2):
        start = _place(content, chance)
        return start, min(start + chance.randrange(1, 200), len(content))
    start = chance.randrange(max(len(content) // SECTOR, 1)) * SECTOR
    return start, min(start + SECTOR * chance.choice((1, 2, 8)), len(content))
