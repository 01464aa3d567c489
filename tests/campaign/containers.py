"""Whole files of every container, altered at random, against what was in them: `python tests/campaign/containers.py`.

Each case alters a small recording (bits, bytes, a cut, zeroed and swapped and repeated sectors, inserted bytes, a piece
of another recording) and reads all of it. What is read has to be what was recorded, or the difference told.
"""

import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from common import Outcome, campaign  # isort: skip  (puts the tests' folders on the path)

from damage_judge import Recovery, Verdict, judge
from sound_recordings import KINDS, sound_recording, write_files

__all__ = ["main"]

SECTOR = 512


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; the exit code."""
    return campaign("containers", _try_case, count=50_000, arguments=arguments, max_case_s=5.0)


_sound = cache(sound_recording)


def _try_case(number: int, chance: Random) -> Outcome:
    sound = _sound(KINDS[number % len(KINDS)])
    recovery: Recovery = chance.choice(("as_needed", "as_needed", "as_needed", "full_scan", "none"))
    name = chance.choice(sorted(sound.files))
    content, how = _altered(sound.files[name], chance)
    files = {**sound.files, name: content}
    with TemporaryDirectory(prefix="lidcam-campaign-") as folder:
        path = write_files(Path(folder), sound, files)
        verdict = judge(sound, path, recovery)
    if verdict.is_fault and name.endswith("-wal") and sound.files[name].startswith(content):
        verdict = Verdict("fewer commits of a write-ahead log that was cut, told as not closed", is_fault=False)
    detail = f"{sound.kind}, {recovery}, {name}: {how}: {verdict.detail}"
    kind = f"{verdict.kind} [{sound.kind}]" if verdict.is_fault else verdict.kind
    return Outcome(kind, verdict.is_fault, detail, files)


def _altered(content: bytes, chance: Random) -> tuple[bytes, str]:
    """A file with one to three alterations, mostly one, and what they are."""
    said = []
    for _ in range(chance.choice((1, 1, 1, 1, 2, 3))):
        alteration = chance.choice(ALTERATIONS) if content else _inserted
        before = content
        content = alteration(content, chance)
        first = next((i for i, (a, b) in enumerate(zip(before, content, strict=False)) if a != b), len(content))
        said.append(f"{alteration.__name__.strip('_')} at {first}")
    return content, ", ".join(said)


def _bit(content: bytes, chance: Random) -> bytes:
    altered = bytearray(content)
    altered[_place(content, chance)] ^= 1 << chance.randrange(8)
    return bytes(altered)


def _byte(content: bytes, chance: Random) -> bytes:
    altered = bytearray(content)
    altered[_place(content, chance)] = chance.choice((0, 0xFF, 0x7F, 0x80, chance.randrange(256)))
    return bytes(altered)


def _few_bytes(content: bytes, chance: Random) -> bytes:
    altered = bytearray(content)
    at = _place(content, chance)
    altered[at : at + 8] = chance.randbytes(len(altered[at : at + 8]))
    return bytes(altered)


def _cut(content: bytes, chance: Random) -> bytes:
    return content[: _place(content, chance)]


def _zeros(content: bytes, chance: Random) -> bytes:
    start, end = _range(content, chance)
    return content[:start] + bytes(end - start) + content[end:]


def _swapped(content: bytes, chance: Random) -> bytes:
    size = SECTOR * chance.choice((1, 2, 8))
    a, b = (chance.randrange(max(len(content) // size, 1)) * size for _ in range(2))
    altered = bytearray(content)
    altered[a : a + size], altered[b : b + size] = content[b : b + size], content[a : a + size]
    return bytes(altered)


def _repeated(content: bytes, chance: Random) -> bytes:
    start, end = _range(content, chance)
    return content[:end] + content[start:]


def _removed(content: bytes, chance: Random) -> bytes:
    start, end = _range(content, chance)
    return content[:start] + content[end:]


def _inserted(content: bytes, chance: Random) -> bytes:
    at = _place(content, chance)
    return content[:at] + chance.randbytes(chance.choice((1, 4, 100))) + content[at:]


def _of_another(content: bytes, chance: Random) -> bytes:
    files = [*_sound(chance.choice(KINDS)).files.values()]
    start, end = _range(source := chance.choice(files), chance)
    at = _place(content, chance)
    return content[:at] + source[start:end] + content[at + end - start :]


ALTERATIONS = (_bit, _bit, _bit, _byte, _few_bytes, _cut, _zeros, _swapped, _repeated, _removed, _inserted, _of_another)


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


if __name__ == "__main__":
    sys.exit(main())
