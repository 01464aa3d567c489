"""A file on a server as a stream that fetches only the parts that are read, by range requests (fsspec).

Whole pages are fetched and kept in a temporary file: nothing is fetched twice until that is full, and memory does not
grow. Sequential reading fetches more and more at once, up to a maximum; a reader that knows what it will read uses
`ReadAhead` to fetch exactly that.
"""

import errno
import io
import logging
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from tempfile import TemporaryFile
from typing import Any, BinaryIO, NamedTuple, TypeVar, cast

from pipeline.core.errors import RecordingError
from readers.location import RemotePath

__all__ = ["ReadAhead", "RemoteFile", "open_remote", "tell_full_read"]

logger = logging.getLogger(__name__)

T = TypeVar("T")

PAGE_BYTES = 1 << 16
MAX_REQUEST_PAGES = 128
MAX_REQUEST_BYTES = MAX_REQUEST_PAGES * PAGE_BYTES
MAX_KEPT_BYTES = 512 << 20
"""Size of the temporary file: several seconds of many cameras and lidars."""

RETRY_DELAYS_S = (0.5, 1.0, 2.0)
SILENCE_S = 30.0
"""A server that sends nothing for this long counts as a lost connection."""

MAX_FACT_CHARACTERS = 200

EXTRAS = {"http": "http", "https": "http", "s3": "s3", "s3a": "s3"}
"""Extra of lidcam that installs what a protocol needs."""

REMEDY = "download it, and read the copy"


class RemoteFile(io.BufferedIOBase):
    """A seekable file on a server.

    Args:
        path: Its location.

    Attributes:
        path: The same, with the facts that the server told.
        size: Size in bytes.

    Raises:
        RecordingError: it cannot be reached, does not exist, has no known size, or an extra is not installed.
    """

    def __init__(self, path: RemotePath) -> None:
        super().__init__()
        self.path = path
        self._position = 0
        self._pages: set[int] = set()
        self._end_of_last = 0  # page after the last one fetched
        self._run = 1  # pages fetched by the last miss
        self._is_wanted_whole = False
        self._system: Any = None
        self._file: Any = None
        self._kept: BinaryIO = TemporaryFile(prefix="lidcam-")  # noqa: SIM115  # closed by close()
        try:
            self._system, self._place = self._attempt("it cannot be opened", lambda: _file_system(path))
            info = self._attempt("it cannot be opened", lambda: self._system.info(self._place))
            self.size = _size(path, info)
            self.path = replace(path, facts=tuple(_facts(info)))
            if self.size:
                options = _open_options(path, info)
                self._file = self._attempt("it cannot be opened", lambda: self._open(options))
        except BaseException:
            self.close()
            raise

    def readable(self) -> bool:
        """Always true."""
        return True

    def seekable(self) -> bool:
        """Always true."""
        return True

    def tell(self) -> int:
        """The current position."""
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Change the position without fetching anything.

        Raises:
            OSError: the position is before the first byte.
        """
        position = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self.size}[whence]
        if position < 0:
            raise OSError(errno.EINVAL, "a position before the beginning of the file")
        self._position = position
        return position

    def read(self, size: int | None = -1, /) -> bytes:
        """The next `size` bytes, or all that are left by default.

        Raises:
            RecordingError: they cannot be fetched; says why.
            ValueError: the file was closed.
        """
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

    def fetch(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Fetch these parts (first byte, size) unless they are kept; adjacent ones in one request.

        Raises:
            RecordingError: they cannot be fetched; says why.
        """
        pages: dict[int, None] = {}
        for start, size in ranges:
            pages |= dict.fromkeys(self._pages_of(start, size))
        self._fetch_pages(pages)

    def fetch_ahead(self) -> None:
        """Fetch as much as possible per request from now on, because the whole file will be read."""
        self._is_wanted_whole = True

    def close(self) -> None:
        """Close the connection and remove the temporary file."""
        if not self.closed:
            self._disconnect()
            self._kept.close()
        super().close()

    def _pages_of(self, start: int, size: int) -> range:
        return range(start // PAGE_BYTES, -(-min(start + size, self.size) // PAGE_BYTES))

    def _need(self, start: int, size: int) -> None:
        """Fetch these bytes unless they are kept, and more of what follows if reading is sequential."""
        pages = self._pages_of(start, size)
        missing = next((page for page in pages if page not in self._pages), None)
        if missing is None:
            return
        more = self._run * 2 if missing == self._end_of_last else 1
        more = MAX_REQUEST_PAGES if self._is_wanted_whole else more
        self._run = min(max(more, len(pages)), MAX_REQUEST_PAGES)
        ahead = range(pages.start, max(pages.stop, min(missing + self._run, -(-self.size // PAGE_BYTES))))
        self._fetch_pages(ahead)

    def _fetch_pages(self, pages: Collection[int]) -> None:
        """Fetch these pages unless they are kept."""
        if (len(self._pages) + sum(page not in self._pages for page in pages)) * PAGE_BYTES > MAX_KEPT_BYTES:
            self._kept.truncate(0)
            self._pages.clear()
        for first, last in _runs(page for page in pages if page not in self._pages):
            start = first * PAGE_BYTES
            data = self._range(start, min(last * PAGE_BYTES, self.size))
            self._kept.seek(start)
            self._kept.write(data)
            self._pages.update(range(first, last))
            self._end_of_last = last

    def _range(self, start: int, stop: int) -> bytes:
        return self._attempt(f"the connection was lost at byte {start}", lambda: self._range_once(start, stop))

    def _range_once(self, start: int, stop: int) -> bytes:
        self._file.seek(start)
        data: bytes = self._file.read(stop - start)
        if len(data) != stop - start:
            raise EOFError(f"{len(data)} of {stop - start} bytes")
        return data

    def _open(self, options: dict[str, Any]) -> Any:
        return self._system.open(self._place, "rb", cache_type="none", **options)

    def _attempt(self, failed: str, action: Callable[[], T]) -> T:
        """The result of `action`, tried again after network errors that may be temporary.

        Raises:
            RecordingError: it failed.
        """
        for attempt, delay_s in enumerate((*RETRY_DELAYS_S, None), 1):
            try:
                return action()
            except RecordingError:
                raise
            except Exception as err:  # any library below fsspec may raise
                fault = _fault(err)
                if fault.passes and delay_s is not None:
                    time.sleep(delay_s)
                    continue
                reason = f"{failed} ({fault.reason}, {attempt} attempts)" if fault.passes else fault.reason
                # Not from err: the libraries quote the whole URL, including secrets.
                raise RecordingError(f"{self.path}: {reason}; {fault.remedy}") from None
        raise RuntimeError("unreachable: the last attempt returns or raises")

    def _disconnect(self) -> None:
        if self._file is not None:
            self._file.close()
        session = getattr(self._system, "_session", None) or getattr(self._system, "_s3creator", None)
        if session is not None:
            self._system.close_session(self._system.loop, session)
        self._file = self._system = None


class ReadAhead:
    """Fetches the parts of a file that will be read in a known order: more and more of them per request.

    The first is fetched alone, because many readers need only the beginning. Does nothing for a local file.

    Args:
        stream: The file.
        parts: First byte and size of each part, in the order of reading.
    """

    def __init__(self, stream: BinaryIO, parts: Iterable[tuple[int, int]]) -> None:
        self._remote = _remote(stream)
        self._parts = [(start, min(size, MAX_REQUEST_BYTES)) for start, size in parts] if self._remote else []
        self._next = 0
        self._bytes = 0

    def reach(self) -> None:
        """Make sure that the next part is there.

        Raises:
            RecordingError: it cannot be fetched; says why.
        """
        if self._remote is None:
            return
        self._next -= 1
        if self._next >= 0:
            return
        taken = 0
        count = 0
        for _, size in self._parts:
            if count and taken + size > self._bytes:
                break
            taken += size
            count += 1
        self._remote.fetch(self._parts[:count])
        self._parts = self._parts[count:]
        self._next = count - 1
        self._bytes = min(max(2 * taken, 2 * self._bytes), MAX_REQUEST_BYTES)


def open_remote(path: RemotePath) -> tuple[RemotePath, BinaryIO]:
    """Open a file on a server; returns its path with the facts that the server told, and a stream.

    Raises:
        RecordingError: it cannot be read; says why.
    """
    remote = RemoteFile(path)
    return remote.path, cast("BinaryIO", remote)


def tell_full_read(stream: BinaryIO, because: str) -> None:
    """Warn that the whole file will be fetched, and fetch it in large parts; does nothing for a local file."""
    if remote := _remote(stream):
        remote.fetch_ahead()
        logger.warning("%s: %s: all of it is fetched, %.1f MB", remote.path, because, remote.size / 1e6)


def _remote(stream: object) -> RemoteFile | None:
    return stream if isinstance(stream, RemoteFile) else None


def _runs(pages: Iterable[int]) -> Iterator[tuple[int, int]]:
    """First page and the one after the last of each run of adjacent pages, each one request; in the order given."""
    first = last = -1
    for page in pages:
        if page != last or last - first == MAX_REQUEST_PAGES:
            if last > first:
                yield first, last
            first = page
        last = page + 1
    if last > first:
        yield first, last


def _file_system(path: RemotePath) -> tuple[Any, str]:
    try:
        import fsspec

        options: dict[str, Any] = {"skip_instance_cache": True}
        if path.protocol in {"http", "https"}:
            import aiohttp

            silence = aiohttp.ClientTimeout(total=None, sock_connect=SILENCE_S, sock_read=SILENCE_S)
            options["client_kwargs"] = {"timeout": silence, "trust_env": True}  # HTTPS_PROXY
            options["encoded"] = path.url.isascii() and " " not in path.url  # a signed URL must not change
        elif path.protocol in {"s3", "s3a"}:
            options["use_listings_cache"] = False
        kind = fsspec.get_filesystem_class(path.protocol)
        system = kind(**kind._get_kwargs_from_urls(path.url), **options)
    except ImportError:
        if extra := EXTRAS.get(path.protocol):
            remedy = f"install it with `pip install 'lidcam[{extra}]'`"
        else:
            remedy = f"install what fsspec needs for it, or {REMEDY}"
        raise RecordingError(f"{path}: reading {path.protocol}:// is not installed; {remedy}") from None
    except ValueError:
        raise RecordingError(f"{path}: lidcam reads https://, http:// and s3://, found {path.protocol}://") from None
    return system, str(kind._strip_protocol(path.url))  # url_to_fs would take "::" for a chain of file systems


def _open_options(path: RemotePath, info: dict[str, Any]) -> dict[str, Any]:
    """Options that make sure that all parts are of the same file (RFC 9110, 13.1); S3 does so by itself."""
    if path.protocol not in {"http", "https"}:
        return {}
    headers = {"Accept-Encoding": "identity"}
    etag, modified = str(info.get("ETag", "")), info.get("Last-Modified")
    if etag.startswith('"'):  # weak ones never match
        headers["If-Match"] = etag
    elif modified:
        headers["If-Unmodified-Since"] = str(modified)
    return {"size": info["size"], "headers": headers}


def _size(path: RemotePath, info: dict[str, Any]) -> int:
    if info.get("type") == "directory":
        raise RecordingError(f"{path}: expected a file, found a folder; name the .mcap files in it")
    if not isinstance(info.get("size"), int):
        raise RecordingError(f"{path}: its server does not say how large it is; {REMEDY}")
    if info.get("partial") is False:
        raise RecordingError(f"{path}: {NO_RANGES.reason}; {NO_RANGES.remedy}")
    return int(info["size"])


def _facts(info: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "size", str(info["size"])
    for name, keys in {"etag": ("ETag", "etag"), "last_modified": ("Last-Modified", "LastModified")}.items():
        value = next((str(info[key]) for key in keys if info.get(key)), "")
        if value and value.isprintable():
            yield name, value[:MAX_FACT_CHARACTERS]


class _Fault(NamedTuple):
    reason: str
    remedy: str
    passes: bool = False


NO_RANGES = _Fault("its server does not give parts of a file (range requests)", REMEDY)
CHANGED = _Fault("it was changed while it was read", "read it again when it is complete")
DENIED = _Fault("access was denied", "check the credentials, and whether a signed link is still valid")
MISSING = _Fault("no such file", "check the address")
NO_CREDENTIALS = _Fault("there are no credentials for it", "set them as for the AWS CLI, or FSSPEC_S3_ANON=true")
UNUSABLE = _Fault("its address cannot be used", "check the address")

BY_STATUS = {401: DENIED, 403: DENIED, 404: MISSING, 410: MISSING, 412: CHANGED, 416: CHANGED}
BY_NAME = {
    "FileExpired": CHANGED,
    "FileNotFoundError": MISSING,
    "IsADirectoryError": MISSING,
    "InvalidURL": UNUSABLE,
    "NoCredentialsError": NO_CREDENTIALS,
    "ParamValidationError": UNUSABLE,
    "PermissionError": DENIED,
}
MAY_PASS = frozenset({408, 425, 429, *range(500, 600)})


def _fault(err: BaseException) -> _Fault:
    """What went wrong, without the library's message, which quotes URLs."""
    chain: list[BaseException] = []
    cause: BaseException | None = err
    while cause is not None and cause not in chain:
        chain.append(cause)
        cause = cause.__cause__
    for cause in chain:
        status = _status(cause)
        if status in BY_STATUS:
            return BY_STATUS[status]._replace(reason=f"{BY_STATUS[status].reason} (HTTP {status})")
        if status is not None:
            return _Fault(f"HTTP {status}", f"try again later, or {REMEDY}", status in MAY_PASS)
    for cause in reversed(chain):
        names = [base.__name__ for base in type(cause).__mro__]
        fault = next((BY_NAME[name] for name in names if name in BY_NAME), None)
        # fsspec raises FileNotFoundError whenever it fails to ask a server.
        if fault is not None and (fault is not MISSING or len(chain) == 1):
            return fault
    if isinstance(chain[-1], ValueError):
        return NO_RANGES if len(chain) == 1 else UNUSABLE
    return _Fault(type(chain[-1]).__name__, "check the network, and try again", passes=True)


def _status(err: BaseException) -> int | None:
    """HTTP status in an error of aiohttp or botocore."""
    status = getattr(err, "status", None)
    response = getattr(err, "response", None)
    if isinstance(response, dict):
        status = response.get("ResponseMetadata", {}).get("HTTPStatusCode")
    return status if isinstance(status, int) else None
