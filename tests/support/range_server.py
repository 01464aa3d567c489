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

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle_any(self) -> None:
            status, content, headers = _answer(state, self)
            self.send_response(status)
            for name, value in ({"Content-Length": str(len(content))} | headers).items():
                self.send_header(name, value)
            self.end_headers()
            body = content if self.command == "GET" else b""
            if body and status in {200, 206} and state.drops:
                state.drops -= 1
                body = body[: len(body) // 2]
                self.close_connection = True
            asked, authorization = self.headers.get("Range", ""), self.headers.get("Authorization", "")
            state.requests.append(Request(self.command, self.path, asked, authorization, status, len(body)))
            try:
                self.wfile.write(body)
            except (BrokenPipeError, ConnectionResetError):  # the client has read enough
                self.close_connection = True

        do_GET = do_HEAD = handle_any

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing on stderr."""

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


def _answer(state: RangeServer, asked: BaseHTTPRequestHandler) -> tuple[int, bytes, dict[str, str]]:
    """Status, content and further headers."""
    path, is_get = urlsplit(asked.path).path, asked.command == "GET"
    content, get = state.files.get(path), asked.headers.get
    status = state.statuses.get(path, 200 if content is not None else 404)
    if state.password and get("Authorization") != f"Basic {state.password}":
        status = 401
    if not is_get and not state.answers_head:
        status = 403
    if target := state.redirects.get(path):
        return 302, b"", {"Location": target}
    if is_get and state.failures:
        state.failures -= 1
        status = 503
    if status != 200 or content is None:
        return status, b"no", {}
    etag = f'"{hash(content)}"'  # which an object of bytes keeps
    known = {"Last-Modified": state.modified, "ETag": etag if state.has_etag else ""}
    headers = {name: value for name, value in known.items() if value}
    headers |= {"Accept-Ranges": "none"} if state.says_so else {}
    if get("If-Match", etag) != etag or get("If-Unmodified-Since", state.modified) != state.modified:
        return 412, b"", {}
    wanted = re.fullmatch(r"bytes=(\d+)-(\d+)", get("Range", ""))
    if wanted is None or not state.gives_ranges:
        return 200, content, headers
    first, last = int(wanted[1]), min(int(wanted[2]), len(content) - 1)
    headers["Content-Range"] = f"bytes {first}-{last}/{len(content)}"
    part = content[first : last + 1] + bytes(max(state.too_many, 0))
    return 206, part[: len(part) + min(state.too_many, 0)], headers
