"""An S3 for tests: moto's server, a program of its own, behind a proxy that counts bytes and fails as stores do."""

import http.client
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class ObjectStore:
    """A running store.

    Attributes:
        url: Its address.
        sent: Bytes of content that it sent, by the path of the object.
        refused: Pattern of requests (`PUT /bucket/key`) that get `status`.
        status: What they get.
        left: How many more of them do.
        cut: Whether their connection is closed in the middle instead.
    """

    url: str = ""
    sent: dict[str, int] = field(default_factory=dict)
    refused: str = "$^"
    status: int = 503
    left: int = 0
    cut: bool = False

    def fail(self, requests: str, status: int = 503, *, times: int = 10**6, cut: bool = False) -> None:
        """Have requests fail that begin so."""
        self.refused, self.status, self.left, self.cut = requests, status, times, cut


@contextmanager
def object_store() -> Iterator[ObjectStore]:
    """A store without buckets, as long as the block lasts."""
    environment = os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": ""}
    program = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", "0"]
    server = subprocess.Popen(program, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment)
    assert server.stderr is not None
    try:
        port = next(int(found[1]) for line in server.stderr if (found := re.search(r"127\.0\.0\.1:(\d+)", line)))
        threading.Thread(target=server.stderr.read, daemon=True).start()
        with _proxy(port) as store:
            yield store
    finally:
        server.send_signal(signal.SIGKILL)
        server.wait()
        server.stderr.close()


@contextmanager
def _proxy(port: int) -> Iterator[ObjectStore]:
    store, lock = ObjectStore(), threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle_any(self) -> None:
            if self.headers.get("Expect", "").lower() == "100-continue":
                pass  # the base class has answered it
            size = int(self.headers.get("Content-Length") or 0)
            with lock:
                fails = store.left > 0 and re.match(store.refused, f"{self.command} {self.path}") is not None
                store.left -= fails
            if fails and store.cut:
                self.rfile.read(size // 2)
                self.close_connection = True
                return
            body = self.rfile.read(size)
            if fails:
                self.answer(store.status, {}, b"")
                return
            inner = http.client.HTTPConnection("127.0.0.1", port)
            inner.request(self.command, self.path, body, dict(self.headers))
            response = inner.getresponse()
            content = response.read()
            with lock:
                path = self.path.partition("?")[0]
                store.sent[path] = store.sent.get(path, 0) + len(content)
            self.answer(response.status, dict(response.headers), content)
            inner.close()

        do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = handle_any

        def answer(self, status: int, headers: dict[str, str], content: bytes) -> None:
            self.send_response_only(status)
            skipped = {"connection", "transfer-encoding", "content-length"}
            for name, value in headers.items():
                if name.lower() not in skipped:
                    self.send_header(name, value)
            length = headers.get("Content-Length", "0") if self.command == "HEAD" else str(len(content))
            self.send_header("Content-Length", length)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing is printed."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    store.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield store
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
