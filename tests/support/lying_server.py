"""A web server that lies: a raw socket behind which every answer is made as a list of lies says."""

import gzip
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import md5

__all__ = ["LIES", "Answer", "LyingServer", "lying_server"]

CRLF = b"\r\n"


@dataclass
class Answer:
    """What a server is about to send.

    Attributes:
        status: Status line without the protocol.
        headers: By name.
        body: What follows them.
        pause_s: Wait after every byte, or every piece, of the body.
        piece: Bytes sent at once.
        is_endless: Whether the body is sent again and again.
        raw: Sent instead of all this.
    """

    status: bytes
    headers: dict[str, str]
    body: bytes
    pause_s: float = 0.0
    piece: int = 1 << 16
    is_endless: bool = False
    raw: bytes | None = None


@dataclass
class LyingServer:
    """What the server has and does; may be changed while it runs.

    Attributes:
        url: Its address.
        content: The file that it has, at every path.
        lies: The lie about each request, in order; the last one again and again. Empty: the truth.
        requests: Head of each request so far.
    """

    url: str
    content: bytes
    lies: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


Lie = Callable[[Answer, LyingServer], None]


def _endless(answer: Answer, _: LyingServer) -> None:
    answer.is_endless = True
    answer.headers.pop("Content-Length", None)


def _endless_in_chunks(answer: Answer, _: LyingServer) -> None:
    answer.headers.pop("Content-Length", None)
    answer.headers["Transfer-Encoding"] = "chunked"
    answer.body, answer.is_endless = b"10000\r\n" + bytes(1 << 16) + CRLF, True


def _gzipped(answer: Answer, _: LyingServer) -> None:
    answer.body = _many_zeros()
    answer.headers |= {"Content-Encoding": "gzip", "Content-Length": str(len(answer.body))}


@lru_cache
def _many_zeros() -> bytes:
    return gzip.compress(bytes(50 << 20), 1)


def _deflated_truth(answer: Answer, _: LyingServer) -> None:
    answer.body = gzip.compress(answer.body)
    answer.headers |= {"Content-Encoding": "gzip", "Content-Length": str(len(answer.body))}


def _dripping(answer: Answer, _: LyingServer) -> None:
    answer.pause_s, answer.piece = 0.1, 1


def _dripping_head(answer: Answer, _: LyingServer) -> None:
    answer.raw, answer.pause_s, answer.piece = b"HTTP/1.1 206 Partial Content\r\nX: " + b"a" * 5000, 0.1, 1


def _silent(answer: Answer, _: LyingServer) -> None:
    answer.raw, answer.pause_s = b" ", 3600.0


def _endless_head(answer: Answer, _: LyingServer) -> None:
    answer.raw, answer.is_endless = b"HTTP/1.1 206 Partial Content\r\n" + b"X-A: b\r\n" * 1000, True


def _endless_interim(answer: Answer, _: LyingServer) -> None:
    answer.raw, answer.is_endless = b"HTTP/1.1 102 Processing\r\n\r\n" * 1000, True


def _garbage(answer: Answer, _: LyingServer) -> None:
    answer.raw = bytes(range(256)) * 20


def _nothing(answer: Answer, _: LyingServer) -> None:
    answer.raw = b""


def _short(answer: Answer, _: LyingServer) -> None:
    answer.body = answer.body[: len(answer.body) // 2]
    answer.headers["Content-Length"] = str(len(answer.body))


def _cut(answer: Answer, _: LyingServer) -> None:
    answer.body = answer.body[: len(answer.body) // 2]


def _long(answer: Answer, _: LyingServer) -> None:
    answer.body += bytes(1000)
    answer.headers["Content-Length"] = str(len(answer.body))


def _huge_length(answer: Answer, _: LyingServer) -> None:
    answer.headers["Content-Length"] = str(10**18)


def _no_length(answer: Answer, _: LyingServer) -> None:
    answer.headers["Content-Length"] = "many"


def _whole(answer: Answer, server: LyingServer) -> None:
    answer.status, answer.body = b"200 OK", server.content if answer.body else b""
    answer.headers.pop("Content-Range", None)
    answer.headers["Content-Length"] = str(len(server.content))


def _shifted(answer: Answer, server: LyingServer) -> None:
    answer.headers["Content-Range"] = f"bytes 1-{len(answer.body)}/{len(server.content)}"


def _no_range(answer: Answer, _: LyingServer) -> None:
    answer.headers.pop("Content-Range", None)


def _multipart(answer: Answer, _: LyingServer) -> None:
    answer.headers.pop("Content-Range", None)
    answer.headers["Content-Type"] = "multipart/byteranges; boundary=x"


def _other_size(answer: Answer, _: LyingServer) -> None:
    if "Content-Range" in answer.headers:
        answer.headers["Content-Range"] = answer.headers["Content-Range"].rpartition("/")[0] + "/99999999"


def _other_etag(answer: Answer, _: LyingServer) -> None:
    answer.headers["ETag"] = '"other"'


def _weak_etag(answer: Answer, _: LyingServer) -> None:
    answer.headers["ETag"] = "W/" + answer.headers["ETag"]


def _other_time(answer: Answer, _: LyingServer) -> None:
    answer.headers["Last-Modified"] = "Mon, 01 Jan 2024 00:00:00 GMT"


def _status(status: str) -> Lie:
    def lie(answer: Answer, _: LyingServer) -> None:
        answer.status, answer.body = status.encode(), b"no"
        answer.headers = {"Content-Length": "2"}

    return lie


def _redirect(target: str) -> Lie:
    def lie(answer: Answer, server: LyingServer) -> None:
        answer.status, answer.body = b"302 Found", b""
        answer.headers = {"Content-Length": "0", "Location": target.format(url=server.url)}

    return lie


LIES: dict[str, Lie] = {
    "truth": lambda _, __: None,
    "another etag": _other_etag,
    "a weak etag": _weak_etag,
    "another size": _other_size,
    "another time": _other_time,
    "an endless body": _endless,
    "an endless body in chunks": _endless_in_chunks,
    "an endless head": _endless_head,
    "an endless number of interim answers": _endless_interim,
    "bytes that are no HTTP": _garbage,
    "no answer": _nothing,
    "a body that drips": _dripping,
    "a head that drips": _dripping_head,
    "a body that is too long": _long,
    "a body that is too short": _short,
    "a body that is cut off": _cut,
    "a compressed body": _deflated_truth,
    "a compressed body of zeros": _gzipped,
    "a huge length": _huge_length,
    "a length that is no number": _no_length,
    "another part": _shifted,
    "a part without its place": _no_range,
    "several parts": _multipart,
    "the whole file": _whole,
    "silence": _silent,
    **{
        f"status {status}": _status(status)
        for status in (
            "204 No Content",
            "403 Forbidden",
            "404 Not Found",
            "429 Slow",
            "500 Bad",
            "503 Busy",
            "999 What",
        )
    },
    **{
        f"a redirect to {target}": _redirect(target)
        for target in (
            "{url}/again",
            "file:///etc/passwd",
            "ftp://127.0.0.1/x",
            "data:text/plain,x",
            "http://127.0.0.1:1/x",
            "http://",
            "//",
            "http://user:s3cret@127.0.0.1:1/x",
        )
    },
}
"""What each lie does to an answer."""


@contextmanager
def lying_server(content: bytes, lies: list[str] | None = None) -> Iterator[LyingServer]:
    """A server on this machine that tells `lies` about its file, one by one."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = LyingServer(f"http://127.0.0.1:{listening.getsockname()[1]}", content, list(lies or []))
        stop = threading.Event()
        listening.settimeout(0.05)
        threads: list[threading.Thread] = []

        def serve() -> None:
            while not stop.is_set():
                with suppress(TimeoutError):
                    connection, _ = listening.accept()
                    threads.append(threading.Thread(target=_converse, args=(connection, server, stop)))
                    threads[-1].start()

        main = threading.Thread(target=serve)
        main.start()
        try:
            yield server
        finally:
            stop.set()
            main.join()
            for thread in threads:
                thread.join()


def _converse(connection: socket.socket, server: LyingServer, stop: threading.Event) -> None:
    """Answer the requests of one connection."""
    connection.settimeout(0.05)
    received = b""
    with connection, suppress(OSError):
        while not stop.is_set():
            try:
                data = connection.recv(1 << 16)
            except TimeoutError:
                continue
            received += data
            if not data:
                return
            while CRLF + CRLF in received:
                head, _, received = received.partition(CRLF + CRLF)
                if not _answer(connection, head.decode("latin1"), server, stop):
                    return


def _answer(connection: socket.socket, head: str, server: LyingServer, stop: threading.Event) -> bool:
    """Send one answer; False where the connection is to end."""
    server.requests.append(head)
    lie = server.lies[min(len(server.requests), len(server.lies)) - 1] if server.lies else "truth"
    answer = _truth(head, server)
    LIES[lie](answer, server)
    headers = "".join(f"{name}: {value}\r\n" for name, value in answer.headers.items()).encode()
    begin = b"HTTP/1.1 " + answer.status + CRLF + headers + CRLF
    body = b"" if head.startswith("HEAD") else answer.body
    sent = answer.raw if answer.raw is not None else begin + body
    quick = 0 if answer.raw is not None else len(begin)
    connection.settimeout(0.5)
    connection.sendall(sent[:quick])
    while True:
        for at in range(quick, len(sent), answer.piece):
            if stop.is_set():
                return False
            connection.sendall(sent[at : at + answer.piece])
            if answer.pause_s:
                stop.wait(answer.pause_s)
        if not answer.is_endless or (not body and answer.raw is None):
            break
    announced = answer.headers.get("Content-Length")
    return answer.raw is None and (announced == str(len(body)) or head.startswith("HEAD"))


def _truth(head: str, server: LyingServer) -> Answer:
    content = server.content
    headers = {"ETag": f'"{md5(content).hexdigest()}"', "Last-Modified": "Tue, 14 Nov 2023 22:13:20 GMT"}
    found = re.search(r"(?im)^range: bytes=(\d+)-(\d+)", head)
    if found is None:
        return Answer(b"200 OK", headers | {"Content-Length": str(len(content))}, content)
    first, last = int(found[1]), min(int(found[2]), len(content) - 1)
    headers["Content-Range"] = f"bytes {first}-{last}/{len(content)}"
    body = content[first : last + 1]
    return Answer(b"206 Partial Content", headers | {"Content-Length": str(len(body))}, body)
