"""Shared parts of the scripts that write pages of the documents: the installed program, tables, parts of a page."""

import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rosbags.rosbag1 import Reader, Writer

ROOT = Path(__file__).resolve().parents[2]
LIDCAM = (sys.executable, "-m", "lidcam")


def run_lidcam(*arguments: object) -> None:
    """Run the installed program; its output is shown only if it fails."""
    command = [*LIDCAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if done.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(command)}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """The lines of a table, and an empty one; nothing without rows."""
    if rows:
        yield f"| {' | '.join(head)} |"
        yield f"|{' --- |' * len(head)}"
        yield from (f"| {' | '.join(row)} |" for row in rows)
        yield ""


def write_part(page: Path, name: str, text: str) -> None:
    """Write the lines between `<!-- NAME: begin -->` and `<!-- NAME: end -->` anew; raises ValueError without these."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, also_found, after = rest.partition(end)
    if not (found and also_found):
        raise ValueError(f"{page}: expected {begin} and {end}")
    page.write_text(f"{before}{begin}\n\n{text.strip()}\n\n{end}{after}", encoding="utf-8")


WITHOUT_HEADER = {"tf2_msgs/msg/TFMessage", "std_msgs/msg/Float64"}
"""Types of the recordings here that do not begin with a header."""

PAUSE_NS = 100_000_000  # pause between the last message and the first of the next time


def repeated(recording: Path, times: int, out: Path) -> Path:
    """Write a ROS 1 recording played several times in a row to `out`, stamps and log times moved on."""
    with Reader(recording) as reader, Writer(out) as writer:
        span_ns = reader.end_time - reader.start_time + PAUSE_NS
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for c in reader.connections
        }
        for turn in range(times):
            shift_ns = turn * span_ns
            for connection, log_ns, data in reader.messages():
                if connection.msgtype not in WITHOUT_HEADER:
                    seconds, nanoseconds = struct.unpack_from("<II", data, 4)
                    stamp_ns = seconds * 10**9 + nanoseconds + shift_ns
                    data = data[:4] + struct.pack("<II", *divmod(stamp_ns, 10**9)) + data[12:]
                writer.write(connections[connection.id], log_ns + shift_ns, data)
    return out
