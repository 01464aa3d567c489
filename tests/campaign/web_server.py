"""A web server that lies: what is read is the file, or one line says why not; soon, and in little memory.

Each case is a server that tells a few lies (`tests/support/lying_server.py`) and the truth otherwise.
"""

import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from common import Outcome, campaign, is_one_line
from lying_server import LIES, lying_server
from mcap.writer import CompressionType, Writer

import readers.files.remote as remote
from pipeline.core.errors import LidcamError
from pipeline.core.settings.recording import LimitsConfig
from readers.location import RemotePath
from readers.open import open_recording
from readers.recording import ReadOptions

__all__ = ["main"]

COUNT = 10 * len(LIES)

REQUEST_S = 1.0
MAX_REQUESTS_IN_TIME = 8
MAX_GROWTH_MIB = 100


def _recording(chance: Random) -> bytes:
    """A file of several requests."""
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "a.mcap"
        with path.open("wb") as stream:
            writer = Writer(stream, 1 << 18, CompressionType.NONE)
            writer.start("ros2", "lidcam tests")
            schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
            channel = writer.register_channel("/text", "cdr", schema)
            for number in range(20):
                data = b"\0\1\0\0" + (50_000).to_bytes(4, "little") + chance.randbytes(50_000)
                writer.add_message(channel, 10**18 + number, data, 10**18 + number)
            writer.finish()  # type: ignore[no-untyped-call]
        return path.read_bytes()


CONTENT = _recording(Random(1))


def _read(url: str) -> list[bytes]:
    options = ReadOptions("none", LimitsConfig(max_request_s=REQUEST_S))
    with open_recording([RemotePath(url)], options) as recording:
        return [bytes(message.data) for message in recording.messages()]


def try_case(number: int, chance: Random) -> Outcome:
    """Read a file from a server that lies."""
    lies = ["truth"] * chance.randrange(4)
    lies += [[*LIES][number % len(LIES)]] * chance.choice([1, 1, 2, 50])
    lies += [chance.choice([*LIES]) for _ in range(chance.choice([0, 0, 1]))]
    lies += ["truth"] * chance.choice([0, 1])
    before_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    with lying_server(CONTENT, lies) as server:
        began_s = time.monotonic()
        told, found = "", None
        try:
            found = _read(server.url.replace("://", "://ada:s3cret@") + "/a.mcap?sig=s3cret")
        except LidcamError as err:
            told = str(err)
        took_s = time.monotonic() - began_s
    grown_mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10) - before_mib
    lie = [*LIES][number % len(LIES)]
    detail = f"{lies[:8]}: {took_s:.1f} s, {grown_mib} MiB, {len(server.requests)} requests: {told}"
    if found is not None and found != EXPECTED:
        return Outcome(f"{lie}: another content", True, detail)
    if told and (not is_one_line(told) or "s3cret" in told):
        return Outcome(f"{lie}: not one line, or a secret", True, detail)
    if took_s > MAX_REQUESTS_IN_TIME * REQUEST_S:
        return Outcome(f"{lie}: slow", True, detail)
    if grown_mib > MAX_GROWTH_MIB:
        return Outcome(f"{lie}: memory", True, detail)
    return Outcome("told in one line" if told else "the file", detail=detail)


def _expected() -> list[bytes]:
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "a.mcap"
        path.write_bytes(CONTENT)
        with open_recording([path]) as recording:
            return [bytes(message.data) for message in recording.messages()]


EXPECTED = _expected()


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 1 if anything fell short."""
    delays, remote.RETRY_DELAYS_S = remote.RETRY_DELAYS_S, (0.01, 0.02, 0.05)
    try:
        return campaign("web_server", try_case, count=COUNT, arguments=arguments, max_case_s=60.0)
    finally:
        remote.RETRY_DELAYS_S = delays


if __name__ == "__main__":
    sys.exit(main())
