"""Clients of `--foxglove`: `python tests/campaign/live.py [--minutes M | --count N] [--seed S]`.

Hundreds connect to a run: some subscribe, some say nothing, some send half a request, some subscribe and read nothing.
The run ends as one that nobody watches, with the same outputs, some seconds after them at most; or at once at Ctrl-C.
"""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random

from common import LIDCAM, ROOT, Child, Outcome, campaign, run_child  # isort: skip
import aiohttp

TIMEOUT_S = 120.0
MAX_END_S = 4.0
"""From the names of the outputs, or Ctrl-C, to the end; a busy machine has its share."""

MAX_MIB = 2000
REQUEST = b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n"


def main() -> int:
    """Run the campaign."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # else what runs in the background ignores it
    return campaign("live", _try_case, count=20, max_case_s=2 * TIMEOUT_S)


def _try_case(number: int, chance: Random) -> Outcome:
    if number:
        counts = {kind: chance.randint(0, most) for kind, most in (("reads", 300), ("silent", 40), ("half", 200))}
        counts["slow"] = chance.randint(0, 3)
    else:
        counts = {"reads": 300, "silent": 40, "half": 200, "slow": 1}
    is_interrupted = number % 4 == 3
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    with tempfile.TemporaryDirectory(prefix="live-") as base:
        out = Path(base, "out.mcap")
        watch = _Watch(port, counts, out, is_interrupted=is_interrupted)
        child = _run(out, "--foxglove", str(port), during=watch)
        late_s = time.monotonic() - watch.named_s if watch.named_s else 0.0
        files = {path.name: path.read_bytes() if path.is_file() else b"" for path in Path(base).iterdir()}
    detail = f"{counts}, Ctrl-C: {is_interrupted}: exit code {child.returncode}, {child.seconds:.1f} s, "
    detail += f"{late_s:.1f} s after the outputs, {child.peak_mib} MiB, {[*files]}\n{child.stderr}"
    is_ended = is_interrupted and child.returncode == 130 and files in ({}, _unwatched())
    if child.is_hung or child.has_traceback or not (is_ended or (child.returncode == 0 and files == _unwatched())):
        return Outcome("not as without clients", is_fault=True, detail=detail)
    if late_s > MAX_END_S or child.peak_mib > MAX_MIB:
        return Outcome("late, or too much memory", is_fault=True, detail=detail)
    return Outcome("ended by Ctrl-C" if is_ended else "as without clients", detail=detail)


class _Watch:
    """Connects clients to a run once it listens, and sees when its output has its name, or is not wanted any more."""

    def __init__(self, port: int, counts: dict[str, int], out: Path, *, is_interrupted: bool) -> None:
        self._port, self._counts, self._out, self._is_interrupted = port, counts, out, is_interrupted
        self.named_s = 0.0

    def __call__(self, process: subprocess.Popen[bytes]) -> None:
        threading.Thread(target=lambda: asyncio.run(self._watch(process.pid)), daemon=True).start()

    async def _watch(self, pid: int) -> None:
        sockets: list[socket.socket] = []
        while not sockets and Path(f"/proc/{pid}").exists():
            with suppress(OSError):
                sockets.append(socket.create_connection(("127.0.0.1", self._port)))
            await asyncio.sleep(0.01)
        with suppress(OSError):
            for number in range(self._counts["silent"] + self._counts["half"]):
                sockets.append(socket.create_connection(("127.0.0.1", self._port)))
                if number < self._counts["half"]:
                    sockets[-1].sendall(REQUEST[: 1 + number % len(REQUEST)])
        clients = [self._client(reads=number >= self._counts["slow"]) for number in range(self._counts["reads"])]
        tasks = [asyncio.create_task(client) for client in clients]
        while not self._out.exists() and Path(f"/proc/{pid}").exists():
            await asyncio.sleep(0.01)
        self.named_s = time.monotonic()
        if self._is_interrupted:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGINT)
        await asyncio.gather(*tasks, return_exceptions=True)
        for one in sockets:
            one.close()

    async def _client(self, *, reads: bool) -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(
                f"http://127.0.0.1:{self._port}", protocols=["foxglove.sdk.v1"], max_msg_size=0
            ) as server,
        ):
            async for message in server:
                if message.type == aiohttp.WSMsgType.TEXT and (said := json.loads(message.data))["op"] == "advertise":
                    wanted = [{"id": one["id"], "channelId": one["id"]} for one in said["channels"]]
                    await server.send_json({"op": "subscribe", "subscriptions": wanted})
                    if not reads:
                        await asyncio.sleep(TIMEOUT_S)


def _run(out: Path, *options: str, during: _Watch | None = None) -> Child:
    part = ("--duration", "1.5", "--workers", "1", "--set", "detect3d.method=cluster")
    recording = str(ROOT / "bags" / "sandbox.bag")
    return run_child([*LIDCAM, "process", recording, str(out), *part, *options], timeout_s=TIMEOUT_S, during=during)


@cache
def _unwatched() -> dict[str, bytes]:
    """The outputs of a run without clients, by name."""
    with tempfile.TemporaryDirectory(prefix="live-") as base:
        _run(Path(base, "out.mcap"))
        return {path.name: path.read_bytes() for path in Path(base).iterdir()}


if __name__ == "__main__":
    sys.exit(main())
