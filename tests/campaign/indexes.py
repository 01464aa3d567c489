"""What says where messages are, altered bit by bit, against the messages: `python tests/campaign/indexes.py`.

Every bit of a short recording that is not part of a message's own bytes or of a compressed chunk: headers, indexes,
counts, times, names, definitions, pages of SQLite, metadata.yaml. With `--count 1000000` each bit has its turn.
"""

import struct
import sys
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from common import Outcome, campaign  # isort: skip  (puts the tests' folders on the path)

from damage_judge import judge
from mcap.opcode import Opcode
from rosbags.rosbag1 import Reader
from sound_recordings import KINDS, SoundRecording, sound_recording, write_files

__all__ = ["main"]

STRIDE = 1_000_003
"""A prime, so that any number of cases is spread over all kinds and bytes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; the exit code."""
    return campaign("indexes", _try_case, count=_bits()[-1][0], arguments=arguments, max_case_s=5.0)


def _try_case(number: int, chance: Random) -> Outcome:
    del chance
    bit = number * STRIDE % _bits()[-1][0]
    ends = [end for end, _, _ in _bits()]
    file = bisect_right(ends, bit)
    before = ends[file - 1] if file else 0
    _, kind, name = _bits()[file]
    sound, places = _places(kind)
    place, shift = places[name][(bit - before) // 8], (bit - before) % 8
    altered = bytearray(sound.files[name])
    altered[place] ^= 1 << shift
    files = {**sound.files, name: bytes(altered)}
    with TemporaryDirectory(prefix="lidcam-campaign-") as folder:
        verdict = judge(sound, write_files(Path(folder), sound, files), "as_needed")
    detail = f"{kind}, {name}: bit {shift} of byte {place}: {verdict.detail}"
    said = f"{verdict.kind} [{kind}]" if verdict.is_fault else verdict.kind
    return Outcome(said, verdict.is_fault, detail, files)


@cache
def _bits() -> list[tuple[int, str, str]]:
    """The number of bits up to and including those of each file, its kind and name."""
    end, bits = 0, []
    for kind in KINDS:
        for name, places in _places(kind)[1].items():
            end += 8 * len(places)
            bits.append((end, kind, name))
    return bits


@cache
def _places(kind: str) -> tuple[SoundRecording, Mapping[str, list[int]]]:
    """A recording, and the bytes of its files that are altered."""
    sound = sound_recording(kind, "shortest")
    places = {}
    for name, content in sound.files.items():
        is_left = bytearray(b"\1" * len(content))
        for start, end in _spared(name, content, sound):
            is_left[start:end] = bytes(end - start)
        places[name] = [place for place, left in enumerate(is_left) if left]
    return sound, places


def _spared(name: str, content: bytes, sound: SoundRecording) -> Iterator[tuple[int, int]]:
    """Where messages, packed data and filling are."""
    for message in sound.messages:
        data = message.data[12:] if sound.kind.startswith("pcap") else message.data  # without a stamp of ours
        at = content.find(data)
        while at >= 0:
            yield at, at + len(data)
            at = content.find(data, at + 1)
    if name.endswith((".bag", ".mcap")):
        yield from _packed(name, content)
    elif name.endswith(".zstd"):
        yield 18, len(content)
    elif ".db3" in name:
        yield from ((place, place + 1) for place, byte in enumerate(content) if not byte and place > 100)
    if name.endswith(".bag"):
        filling = content.index(b" " * 100)
        yield filling, filling + 4096 - 200


def _packed(name: str, content: bytes) -> Iterator[tuple[int, int]]:
    """Where compressed chunks are."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        if name.endswith(".bag"):
            with Reader(path) as reader:
                for chunk in reader.chunks.values():
                    if content[chunk.datapos : chunk.datapos + 3] == b"BZh" or content[chunk.datapos] == 4:
                        yield chunk.datapos, chunk.datapos + chunk.datasize
            return
    at = 8
    while at + 9 <= len(content) - 8:
        opcode, size = struct.unpack_from("<BQ", content, at)
        (compression,) = struct.unpack_from("<I", content, at + 9 + 28) if opcode == Opcode.CHUNK else (0,)
        if compression:
            yield at + 9 + 32 + compression + 8, at + 9 + size
        at += 9 + size


if __name__ == "__main__":
    sys.exit(main())
