"""One wrong time in a sound recording: `python tests/campaign/stamps.py [--minutes M | --count N] [--seed S]`.

A message of a small drive gets another stamp (a flipped bit, before 1970, after 2038, hours away, nanoseconds beyond a
second) or another log time, and the recording is inspected and processed. Every other frame must come out as without
the change, every message must be used or counted as dropped, and the output must open with the times that it should
have. With `on_bad_message=fail`, one line may end the run.
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Literal
from zlib import crc32

from common import Outcome, campaign, is_one_line  # isort: skip
from builders import write_mcap, write_rosbag1, write_rosbag2
from mcap.reader import make_reader
from small_drive import START_NS, small_drive

from lidcam import api
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import RawMessage

Form = Literal["rosbag1", "mcap", "sqlite"]
Motion = Literal["odometry", "tf"]
FORMS: tuple[Form, ...] = ("rosbag1", "mcap", "sqlite")
MOTIONS: tuple[Motion, ...] = ("odometry", "tf")
STAMP_AT = {"/tf": 8, "/tf_static": 8}
"""Place of a message's first stamp; 4 in all types that begin with a header, of ROS 1 and CDR alike."""

END_NS = {"rosbag1": 2**32 * 10**9, "mcap": 2**64, "sqlite": 2**63}
SECONDS = (0, 1, -1, 2**31 - 1, 2**31, 2**32 - 1, 2**30)
APART_S = (-86400 * 400, -3600, -40, -2, -0.3, -0.05, 0.05, 0.3, 2, 40, 3600, 86400 * 400)
PLAUSIBLE_NS = 10**9
"""A message that is no further away may belong to another frame."""

END_OF_DRIVE_NS = START_NS + 12 * 10**8

Key = tuple[str, int]


@dataclass(frozen=True, slots=True)
class _Run:
    """What a run made of a recording: messages of each frame, messages used or dropped by topic, and more."""

    frames: frozenset[frozenset[Key]]
    stamps_ns: tuple[int, ...]
    compensated: int
    accounted: dict[str, int]
    losses: int


def _try_case(_: int, chance: Random) -> Outcome:
    form, motion = chance.choice(FORMS), chance.choice(MOTIONS)
    encoding: Literal["ros1", "cdr"] = "ros1" if form == "rosbag1" else "cdr"
    drive = [*_drive(encoding, motion)]
    row = chance.randrange(len(drive))
    told, changed = _changed(drive[row], form, chance)
    drive[row] = changed
    policy: Literal["skip", "fail"] = "fail" if chance.random() < 0.15 else "skip"
    with tempfile.TemporaryDirectory() as folder:
        path = _written(Path(folder), form, drive)
        what = f"{form}, {motion}, {policy}: message {row} ({changed.topic}): {told}"
        try:
            api.inspect(path)
            found = _process(path, Path(folder) / "out.mcap", policy)
        except LidcamError as err:
            if policy == "fail" and is_one_line(str(err)):
                return Outcome("one line", detail=f"{what}: {err}")
            return Outcome("ended without output", is_fault=True, detail=f"{what}: {err}")
    fault = _fault(_clean(form, motion), found, _drive(encoding, motion)[row], changed)
    return Outcome(fault or "all other frames stand", is_fault=bool(fault), detail=what)


def _changed(message: RawMessage, form: Form, chance: Random) -> tuple[str, RawMessage]:
    """What was changed, and the message with another stamp, another log time, or both."""
    told, which = "", chance.choice(("stamp", "stamp", "log time", "both"))
    if which != "log time":
        at = STAMP_AT.get(message.topic, 4)
        data = bytearray(message.data)
        stamp = _other_stamp(data[at : at + 8], chance)
        data[at : at + 8] = stamp
        told += f"stamp {int.from_bytes(stamp[:4], 'little')} s {int.from_bytes(stamp[4:], 'little')} ns "
        message = message._replace(data=bytes(data))
    if which != "stamp":
        log_time_ns = _other_log_time(message.log_time_ns, END_NS[form], chance)
        told += f"log time {log_time_ns} ns"
        message = message._replace(log_time_ns=log_time_ns)
    return told, message


def _other_stamp(stamp: bytes | bytearray, chance: Random) -> bytes:
    sec, nanosec = (int.from_bytes(stamp[at : at + 4], "little") for at in (0, 4))
    match chance.randrange(6):
        case 0:
            return (int.from_bytes(stamp, "little") ^ 1 << chance.randrange(64)).to_bytes(8, "little")
        case 1:
            sec = chance.choice(SECONDS)
        case 2:
            nanosec = chance.choice((10**9, 2**31, 2**32 - 1, nanosec + 10**9))
        case 3:
            sec, nanosec = nanosec, sec
        case 4:
            sec, nanosec = divmod(sec * 10**9 + nanosec + round(chance.choice(APART_S) * 1e9), 10**9)
        case _:
            return chance.randbytes(8)
    return b"".join((number % 2**32).to_bytes(4, "little") for number in (sec, nanosec))


def _other_log_time(log_time_ns: int, end_ns: int, chance: Random) -> int:
    match chance.randrange(4):
        case 0:
            other = log_time_ns ^ 1 << chance.randrange(end_ns.bit_length() - 1)
        case 1:
            other = chance.choice((0, 1, 10**9, 2**31 * 10**9, 2**32 * 10**9 - 1, end_ns - 1))
        case 2:
            other = log_time_ns + round(chance.choice(APART_S) * 1e9)
        case _:
            other = chance.randrange(end_ns)
    return min(max(other, 0), end_ns - 1)


@cache
def _drive(encoding: Literal["ros1", "cdr"], motion: Motion) -> tuple[RawMessage, ...]:
    return tuple(small_drive(encoding, motion=motion, kinds=("images", "boxes")))


@cache
def _clean(form: Form, motion: Motion) -> _Run:
    """The run of the drive as it is."""
    with tempfile.TemporaryDirectory() as folder:
        drive = _drive("ros1" if form == "rosbag1" else "cdr", motion)
        return _process(_written(Path(folder), form, drive), Path(folder) / "out.mcap", "skip")


def _written(folder: Path, form: Form, drive: Sequence[RawMessage]) -> Path:
    path = folder / {"rosbag1": "a.bag", "mcap": "a.mcap", "sqlite": "a"}[form]
    match form:
        case "rosbag1":
            write_rosbag1(path, drive, chunk_bytes=20_000)
        case "mcap":
            write_mcap(path, drive, chunk_bytes=20_000)
        case _:
            write_rosbag2(path, drive)
    return path


def _process(path: Path, out: Path, policy: Literal["skip", "fail"]) -> _Run:
    frames: list[frozenset[Key]] = []
    stamps_ns: list[int] = []

    def seen(frame: FrameResult) -> None:
        stamps_ns.append(frame.bundle.stamp_ns)
        frames.append(frozenset(map(_key, frame.bundle.messages.values())))

    summary = api.process(path, out, on_frame=seen, on_bad_message=policy, workers=1).summary
    accounted = dict(summary.inputs.messages_used)
    for drop in summary.drops.messages:
        if drop.unit == "messages":
            accounted[drop.topic] = accounted.get(drop.topic, 0) + drop.count
    _check_output(out)
    return _Run(frozenset(frames), tuple(stamps_ns), summary.frames.compensated, accounted, len(summary.inputs.losses))


def _check_output(out: Path) -> None:
    """Whether an independent reader reads it."""
    with out.open("rb") as stream:
        if not sum(1 for _ in make_reader(stream).iter_messages()):
            raise AssertionError("an output without messages")


def _key(message: RawMessage) -> Key:
    return message.topic, crc32(message.data)


def _fault(clean: _Run, found: _Run, before: RawMessage, after: RawMessage) -> str:
    """What is wrong with a run of the drive in which one message was changed; empty if nothing is."""
    if found.losses:
        return "" if after.log_time_ns >= 2**63 else "a sound file called damaged"
    for topic, recorded in clean.accounted.items():
        if found.accounted.get(topic, 0) != recorded:
            return "a message was neither used nor dropped"
    late = after.log_time_ns != before.log_time_ns  # one that was recorded late may be a frame of its own
    first_ns, last_ns = START_NS - PLAUSIBLE_NS, END_OF_DRIVE_NS + PLAUSIBLE_NS
    if not late and not first_ns <= min(found.stamps_ns) <= max(found.stamps_ns) <= last_ns:
        return "a frame with a wrong stamp"
    apart_ns = max(abs(_stamp_ns(after) - _stamp_ns(before)), abs(after.log_time_ns - before.log_time_ns))
    if apart_ns <= PLAUSIBLE_NS:
        return "" if len(found.frames) >= len(clean.frames) - 2 else "frames lost to a plausible change"
    one = {_key(before), _key(after)}
    without = {frame - one for frame in found.frames}
    lost = [frame for frame in clean.frames if frame - one not in without]
    if len(lost) > (before.topic == "/points") or any(_key(before) not in frame for frame in lost):
        return "other frames lost"
    return "motion lost" if found.compensated < len(found.frames) - 1 else ""


def _stamp_ns(message: RawMessage) -> int:
    at = STAMP_AT.get(message.topic, 4)
    sec, nanosec = (int.from_bytes(message.data[place : place + 4], "little") for place in (at, at + 4))
    return sec * 10**9 + nanosec


if __name__ == "__main__":
    sys.exit(campaign("stamps", _try_case, count=400))
