"""A web server for tests that gives parts of files, counts what is asked of it, and fails as servers do."""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit


@dataclass(frozen=True)
class Request:
    """One request: what was asked and how many bytes of content were sent."""

    method: str
    target: str
    range: str
    authorization: str
    status: int
    sent: int


@dataclass
class RangeServer:
    """What a running server has and does; may be changed while it runs.

    Attributes:
        url: Its address, without a slash at the end.
        files: Content by path (`/rec.mcap`).
        requests: What was asked so far.
        gives_ranges: Whether it gives parts; without, it sends whole files.
        says_so: Whether it says that it does not.
        answers_head: Whether it answers HEAD; those that sign links for GET refuse it.
        has_etag: Whether it sends ETags, and heeds them.
        modified: Last-Modified that it sends and heeds; empty for none.
        statuses: Status to answer instead, by path.
        drops: Number of GETs to cut off in the middle.
        failures: Number of GETs to answer with status 503.
        too_many: Bytes that it adds to each part, or leaves out.
        redirects: Path to send to, by path.
        password: Base64 of `user:password` that it wants, if any.
    """

    url: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    requests: list[Request] = field(default_factory=list)
    gives_ranges: bool = True
    says_so: bool = False
    answers_head: bool = True
    has_etag: bool = True
    modified: str = formatdate(1_700_000_000, usegmt=True)
    statuses: dict[str, int] = field(default_factory=dict)
    drops: int = 0
    failures: int = 0
    too_many: int = 0
    redirects: dict[str, str] = field(default_factory=dict)
    password: str = ""

    @property
    def sent(self) -> int:
        """Bytes of content sent so far."""
        return sum(request.sent for request in self.requests)


@contextmanager
def range_server(files: dict[str, bytes] | None = None) -> Iterator[RangeServer]:
    """A server on this machine, in a thread of its own."""
    state = RangeServer(files=dict(files or {}))

    class Handler(_Handler):
        server_state = state

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    state.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield state
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_state: RangeServer

    def do_HEAD(self) -> None:
        self._answer(has_body=False)

    def do_GET(self) -> None:
        self._answer(has_body=True)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing on stderr."""

    def _answer(self, *, has_body: bool) -> None:
        state = self.server_state
        path = urlsplit(self.path).path
        content = state.files.get(path)
        status = state.statuses.get(path, 200 if content is not None else 404)
        if state.password and self.headers.get("Authorization") != f"Basic {state.password}":
            status = 401
        if not has_body and not state.answers_head:
            status = 403
        if target := state.redirects.get(path):
            self._send(302, b"", {"Location": target}, has_body=has_body)
            return
        if has_body and state.failures:
            state.failures -= 1
            status = 503
        if status != 200 or content is None:
            self._send(status, b"no", {}, has_body=has_body)
            return
        etag = f'"{hash(content)}"'  # which an object of bytes keeps
        known = {"Last-Modified": state.modified, "ETag": etag if state.has_etag else ""}
        headers = {name: value for name, value in known.items() if value}
        headers |= {"Accept-Ranges": "none"} if state.says_so else {}
        unmodified_since = self.headers.get("If-Unmodified-Since", state.modified)
        if self.headers.get("If-Match", etag) != etag or unmodified_since != state.modified:
            self._send(412, b"", {}, has_body=has_body)
            return
        wanted = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if wanted is None or not state.gives_ranges:
            self._send(200, content, headers, has_body=has_body)
            return
        first, last = int(wanted[1]), min(int(wanted[2]), len(content) - 1)
        headers["Content-Range"] = f"bytes {first}-{last}/{len(content)}"
        part = content[first : last + 1] + bytes(max(state.too_many, 0))
        self._send(206, part[: len(part) + min(state.too_many, 0)], headers, has_body=has_body)

    def _send(self, status: int, content: bytes, headers: dict[str, str], *, has_body: bool) -> None:
        state = self.server_state
        self.send_response(status)
        for name, value in ({"Content-Length": str(len(content))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        body = content if has_body else b""
        if body and status in {200, 206} and state.drops:
            state.drops -= 1
            body = body[: len(body) // 2]
            self.close_connection = True
        range_, authorization = self.headers.get("Range", ""), self.headers.get("Authorization", "")
        state.requests.append(Request(self.command, self.path, range_, authorization, status, len(body)))
        try:
            self.wfile.write(body)
        except (BrokenPipeError, ConnectionResetError):  # the client has read enough
            self.close_connection = True
