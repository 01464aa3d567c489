"""A file on a server as a stream that fetches only the parts that are read, by range requests of fsspec.

Whole pages are fetched and kept in a temporary file: nothing is fetched twice until that is full, and memory does not
grow. Sequential reading doubles what is fetched at once, up to a maximum. On web servers each request names the version
of the file that was opened. What cannot be fetched raises a `RecordingError` that says why, without secrets.
"""

import errno
import io
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from tempfile import TemporaryFile
from typing import Any, BinaryIO, TypeVar, cast

from lidcam.pipeline.core.errors import RecordingError, is_short_memory
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.location import RemotePath

logger = logging.getLogger(__name__)

T = TypeVar("T")

PAGE_BYTES = 1 << 16
MAX_REQUEST_PAGES = 128
MAX_KEPT_BYTES = 512 << 20
"""Size of the temporary file: several seconds of many cameras and lidars."""

RETRY_DELAYS_S = (0.5, 1.0, 2.0)
MAX_SILENCE_S = 30.0
"""Longest silence of a server before its connection counts as lost."""

HEADERS = {"Accept-Encoding": "identity"}

EXTRAS = {"http": "http", "https": "http", "s3": "s3", "s3a": "s3"}
"""The protocols that are read, and the extra of lidcam that installs what each needs."""

REMEDY = "download it, and read the copy"
NO_RANGES = f"its server does not give parts of a file (range requests); {REMEDY}"
CHANGED = "it was changed while it was read{status}; read it again when it is complete"
DENIED = "access was denied{status}; check the credentials, and whether a signed link is still valid"
MISSING = "no such file{status}; check the address"
BY_STATUS = {401: DENIED, 403: DENIED, 404: MISSING, 410: MISSING, 412: CHANGED, 416: CHANGED}
BY_NAME = {
    "FileExpired": CHANGED,
    "FileNotFoundError": MISSING,
    "NoCredentialsError": "there are no credentials for it; set them as for the AWS CLI, or FSSPEC_S3_ANON=true",
    "PermissionError": DENIED,
    "ValueError": "its address cannot be used; check the address",
}
MAY_PASS = frozenset({"ClientConnectionError", "ClientPayloadError", "EOFError", "OSError", "TimeoutError"})
STATUS_MAY_PASS = frozenset({408, 425, 429, *range(500, 600)})


class _AnswerError(Exception):
    """An answer of a server cannot be used; its text says why, and what to do."""


class RemoteFile(io.BufferedIOBase):
    """A seekable file on a server.

    Attributes:
        path: The same, with the facts that the server gave.
        size: Size in bytes.
        is_wanted_whole: Whether the whole file will be read: then each request fetches as much as possible.
    """

    def __init__(self, path: RemotePath, limits: RecordingLimits = DEFAULT_LIMITS) -> None:
        super().__init__()
        self.path, self._limits = path, limits
        self._position = 0
        self._pages: set[int] = set()
        self._end_of_last = 0  # page after the last one fetched
        self._run_pages = 1  # fetched by the last miss
        self.is_wanted_whole = False
        self._file: Any = None
        self._disconnect: Callable[[], None] = lambda: None
        self._kept: BinaryIO = TemporaryFile(prefix="lidcam-")  # noqa: SIM115  # closed by close()
        try:
            self._attempt("it cannot be opened", self._open)
        except BaseException:
            self.close()
            raise

    def tell(self) -> int:
        """The current position."""
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Change the position without fetching anything; raises OSError if the position is before the first byte."""
        position = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self.size}[whence]
        if position < 0:
            raise OSError(errno.EINVAL, "a position before the beginning of the file")
        self._position = position
        return position

    def read(self, size: int | None = -1, /) -> bytes:
        """The next `size` bytes, or all that are left by default."""
        if self.closed:
            raise ValueError("read of a closed file")
        left = max(self.size - self._position, 0)
        size = left if size is None or size < 0 else min(size, left)
        if not size:
            return b""
        self._need(self._position, size)
        self._kept.seek(self._position)
        self._position += size
        return self._kept.read(size)

    def close(self) -> None:
        """Close the connection and remove the temporary file."""
        if not self.closed:
            self._disconnect()
            self._file = None
            self._kept.close()
        super().close()

    def _open(self) -> None:
        """Ask the server for the facts about the file, and open it."""
        is_web = self.path.protocol in {"http", "https"}
        system = file_system(self.path, self._limits.max_request_s)
        if is_web:
            from fsspec.asyn import sync

            self._disconnect()
            self._disconnect = partial(system.close_session, system.loop, sync(system.loop, system.set_session))
        info = system.info(self.path.url)
        if info.get("type") == "directory":
            raise RecordingError(f"{self.path}: expected a file, found a folder; name the .mcap files in it")
        if not isinstance(info.get("size"), int):
            raise _AnswerError(f"its server does not say how large it is; {REMEDY}")
        if info.get("partial") is False:
            raise _AnswerError(NO_RANGES)
        self.size = int(info["size"])
        known = {"etag": ("ETag", "etag"), "last_modified": ("LastModified", "Last-Modified")}
        facts = {name: next((str(info[key]) for key in keys if info.get(key)), "") for name, keys in known.items()}
        shown = {"size": str(self.size), **facts}
        self.path = replace(self.path, facts=tuple((name, value) for name, value in shown.items() if value))
        options: dict[str, Any] = {}
        if is_web:
            headers = {"If-Match": facts["etag"]} if facts["etag"].startswith('"') else {}  # weak ones never match
            if not headers and facts["last_modified"]:
                headers = {"If-Unmodified-Since": facts["last_modified"]}
            options = {"size": self.size, "headers": HEADERS | headers}
        if self.size:
            self._file = system.open(self.path.url, "rb", cache_type="none", **options)

    def _need(self, start: int, size: int) -> None:
        """Fetch these bytes unless they are kept, and more of what follows if reading is sequential."""
        first, stop = start // PAGE_BYTES, -(-(start + size) // PAGE_BYTES)
        missing = next((page for page in range(first, stop) if page not in self._pages), None)
        if missing is None:
            return
        more = self._run_pages * 2 if missing == self._end_of_last else 1
        more = MAX_REQUEST_PAGES if self.is_wanted_whole else more
        self._run_pages = min(max(more, stop - first), MAX_REQUEST_PAGES)
        stop = max(stop, min(missing + self._run_pages, -(-self.size // PAGE_BYTES)))
        if (len(self._pages) + stop - missing) * PAGE_BYTES > MAX_KEPT_BYTES:
            self._kept.truncate(0)
            self._pages.clear()
        while first < stop:
            if first in self._pages:
                first += 1
                continue
            most = range(first, min(first + MAX_REQUEST_PAGES, stop))
            end = next((page for page in most if page in self._pages), most.stop)
            data = self._range(first * PAGE_BYTES, min(end * PAGE_BYTES, self.size))
            self._kept.seek(first * PAGE_BYTES)
            self._kept.write(data)
            self._pages.update(range(first, end))
            first = self._end_of_last = end

    def _range(self, start: int, stop: int) -> bytes:
        def once() -> bytes:
            try:
                self._file.seek(start)
                data = bytes(self._file.read(stop - start))
            except ValueError:  # fsspec says that the server sent something else than a part
                raise _AnswerError(NO_RANGES) from None
            if len(data) != stop - start:
                raise EOFError(f"{len(data)} of {stop - start} bytes")
            return data

        return self._attempt(f"the connection was lost at byte {start}", once)

    def _attempt(self, failed: str, action: Callable[[], T]) -> T:
        """The result of `action`, tried again after network errors that may be temporary."""
        end_s = time.monotonic() + self._limits.max_request_s
        for attempt, delay_s in enumerate((*RETRY_DELAYS_S, None), 1):
            try:
                return action()
            except RecordingError:
                raise
            except Exception as err:  # any library below may raise
                if is_short_memory(err):
                    raise
                reason, may_pass = meaning_of(err)
                if may_pass and delay_s is not None and time.monotonic() + delay_s < end_s:
                    time.sleep(delay_s)
                    continue
                if may_pass:
                    reason = f"{failed} ({reason}, {attempt} attempts); check the network, and try again"
                # Not from err: the libraries quote the whole URL, including secrets.
                raise RecordingError(f"{self.path}: {reason}") from None
        raise RuntimeError("unreachable: the last attempt returns or raises")


def open_remote(path: RemotePath, limits: RecordingLimits = DEFAULT_LIMITS) -> tuple[RemotePath, BinaryIO]:
    """Open a file on a server; returns its path with the facts that the server gave, and a stream."""
    remote = RemoteFile(path, limits)
    return remote.path, cast("BinaryIO", remote)


def warn_of_full_read(stream: BinaryIO, because: str) -> None:
    """Warn that the whole file will be fetched, and fetch it in large parts; does nothing for a local file."""
    file: object = stream
    if isinstance(file, RemoteFile):
        file.is_wanted_whole = True
        logger.warning("%s: %s: all of it is fetched, %.1f MB", file.path, because, file.size / 1e6)


def file_system(path: RemotePath, max_request_s: float = DEFAULT_LIMITS.max_request_s) -> Any:
    """The file system of fsspec for a protocol."""
    if path.protocol not in EXTRAS:
        raise RecordingError(f"{path}: lidcam reads https://, http:// and s3://, found {path.protocol}://")
    try:
        import fsspec

        options: dict[str, Any] = {}
        if path.protocol in {"http", "https"}:
            from aiohttp import ClientTimeout

            silence_s = min(MAX_SILENCE_S, max_request_s)
            timeout = ClientTimeout(total=max_request_s, sock_connect=silence_s, sock_read=silence_s)
            options["client_kwargs"] = {"timeout": timeout, "trust_env": True, "auto_decompress": False}  # HTTPS_PROXY
            options["headers"] = HEADERS
            options["encoded"] = path.url.isascii() and " " not in path.url  # a signed URL must not change
        else:
            options["use_listings_cache"] = False
        kind = fsspec.get_filesystem_class(path.protocol)
    except ImportError:
        remedy = f"pip install 'lidcam[{EXTRAS[path.protocol]}]'"
        raise RecordingError(f"{path}: {path.protocol}:// needs a library that is not installed: {remedy}") from None
    return kind(skip_instance_cache=True, **options)


def meaning_of(err: BaseException) -> tuple[str, bool]:
    """Meaning of an error of the libraries below, without secrets, and whether the same request may succeed."""
    if isinstance(err, _AnswerError):
        return str(err), False
    chain = [err]
    while chain[-1].__cause__ is not None and chain[-1].__cause__ not in chain:
        chain.append(chain[-1].__cause__)
    if status := next(filter(None, map(_status, chain)), None):
        if status in BY_STATUS:
            return BY_STATUS[status].format(status=f" (HTTP {status})"), False
        may_pass = status in STATUS_MAY_PASS
        return f"HTTP {status}" + ("" if may_pass else f"; try again later, or {REMEDY}"), may_pass
    if len(chain) > 1 and isinstance(err, FileNotFoundError):
        del chain[0]  # fsspec raises it for any error
    names = [base.__name__ for link in reversed(chain) for base in type(link).__mro__]
    if reason := next((BY_NAME[name] for name in names if name in BY_NAME), ""):
        return reason.format(status=""), False
    may_pass = not MAY_PASS.isdisjoint(names)
    return names[0] + ("" if may_pass else f"; check the address, or {REMEDY}"), may_pass


def _status(err: BaseException) -> int | None:
    """HTTP status in an error of aiohttp or botocore."""
    status = getattr(err, "status", None)
    response = getattr(err, "response", None)
    if isinstance(response, dict):
        status = response.get("ResponseMetadata", {}).get("HTTPStatusCode")
    return status if isinstance(status, int) else None
