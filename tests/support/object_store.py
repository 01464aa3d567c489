"""An S3 for tests: moto's application in a thread, which counts the bytes that it sends and fails as stores do."""

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from typing import Any

from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import WSGIRequestHandler, make_server


@dataclass
class ObjectStore:
    """A running store.

    Attributes:
        url: Its address.
        sent: Bytes of content that it sent, by the path of the object.
        refused: Pattern of requests (`PUT /bucket/key`) that get `status`.
        status: What they get.
        left: How many more of them do.
    """

    url: str = ""
    sent: dict[str, int] = field(default_factory=dict)
    refused: str = "$^"
    status: int = 503
    left: int = 0

    def fail(self, requests: str, status: int = 503, *, times: int = 10**6) -> None:
        """Have requests fail that begin so."""
        self.refused, self.status, self.left = requests, status, times


@contextmanager
def object_store() -> Iterator[ObjectStore]:
    """A store without buckets, as long as the block lasts."""
    store, lock, moto = ObjectStore(), threading.Lock(), DomainDispatcherApplication(create_backend_app)

    def application(request: dict[str, Any], start: Callable[..., Any]) -> list[bytes]:
        path = request["PATH_INFO"]
        with lock:
            fails = store.left > 0 and re.match(store.refused, f"{request['REQUEST_METHOD']} {path}") is not None
            store.left -= fails
        if fails:
            request["wsgi.input"].read(int(request.get("CONTENT_LENGTH") or 0))
            start(f"{store.status} refused", [("Content-Length", "0")])
            return [b""]
        with closing(moto(request, start)) as parts:
            content = b"".join(parts)
        with lock:
            store.sent[path] = store.sent.get(path, 0) + len(content)
        return [content]

    class Silent(WSGIRequestHandler):
        def log(self, kind: str, message: str, *args: Any) -> None:
            """Nothing is printed."""

    server = make_server("127.0.0.1", 0, application, threaded=True, request_handler=Silent)
    store.url = f"http://127.0.0.1:{server.port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield store
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
