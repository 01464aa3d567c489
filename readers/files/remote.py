"""A file on a server as a stream that fetches only the parts that are read, by range requests.

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
from io import BytesIO
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypeVar, cast

from pipeline.core.errors import RecordingError, is_short_memory
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.files.remote_faults import NO_RANGES, REMEDY, Fault, ServerError, fault_of
from readers.location import RemotePath

if TYPE_CHECKING:
    from readers.files.web import WebFile

__all__ = ["ReadAhead", "RemoteFile", "open_remote", "tell_full_read"]

logger = logging.getLogger(__name__)

T = TypeVar("T")

PAGE_BYTES = 1 << 16
MAX_REQUEST_PAGES = 128
MAX_REQUEST_BYTES = MAX_REQUEST_PAGES * PAGE_BYTES
MAX_KEPT_BYTES = 512 << 20
"""Size of the temporary file: several seconds of many cameras and lidars."""

RETRY_DELAYS_S = (0.5, 1.0, 2.0)
REQUEST_SHARE = 0.2
"""Share of the time that a request may take that one is meant to take."""

MAX_FACT_CHARACTERS = 200

EXTRAS = {"http": "http", "https": "http", "s3": "s3", "s3a": "s3"}
"""Extra of lidcam that installs what a protocol needs."""

NO_SIZE = Fault("its server does not say how large it is", REMEDY)


class RemoteFile(io.BufferedIOBase):
    """A seekable file on a server.

    Args:
        path: Its location.
        limits: How long a request may take.

    Attributes:
        path: The same, with the facts that the server told.
        size: Size in bytes.

    Raises:
        RecordingError: it cannot be reached, does not exist, has no known size, or an extra is not installed.
    """

    def __init__(self, path: RemotePath, limits: LimitsConfig = DEFAULT_LIMITS) -> None:
        super().__init__()
        self.path = path
        self._position = 0
        self._pages: set[int] = set()
        self._end_of_last = 0  # page after the last one fetched
        self._run = 1  # pages fetched by the last miss
        self._is_wanted_whole = False
        self._limits = limits
        self._max_pages = MAX_REQUEST_PAGES  # fewer where the server is slow
        self._opened: _Opened | None = None
        self._kept: BinaryIO = TemporaryFile(prefix="lidcam-")  # noqa: SIM115  # closed by close()
        try:
            self._opened = self._attempt("it cannot be opened", lambda: _opened(path, limits))
            self.size = self._opened.size
            self.path = replace(path, facts=self._opened.facts)
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
        wanted = [page for page in pages if page not in self._pages]
        while wanted:
            first, last = next(_runs(wanted, self._max_pages))
            wanted = wanted[last - first :]
            start = first * PAGE_BYTES
            began_s = time.monotonic()
            data = self._range(start, min(last * PAGE_BYTES, self.size))
            self._adapt(len(data), time.monotonic() - began_s)
            self._kept.seek(start)
            self._kept.write(data)
            self._pages.update(range(first, last))
            self._end_of_last = last

    def _adapt(self, size: int, seconds: float) -> None:
        """Ask for as much at once as takes a small part of the time that a request may take."""
        rate = size / max(seconds, 1e-3)
        pages = int(rate * self._limits.max_request_s * REQUEST_SHARE) // PAGE_BYTES
        self._max_pages = min(max(pages, 1), MAX_REQUEST_PAGES)

    def _range(self, start: int, stop: int) -> bytes:
        return self._attempt(f"the connection was lost at byte {start}", lambda: self._range_once(start, stop))

    def _range_once(self, start: int, stop: int) -> bytes:
        assert self._opened is not None
        data = self._opened.read(start, stop)
        if len(data) != stop - start:
            raise EOFError(f"{len(data)} of {stop - start} bytes")
        return data

    def _attempt(self, failed: str, action: Callable[[], T]) -> T:
        """The result of `action`, tried again after network errors that may be temporary.

        Raises:
            RecordingError: it failed.
        """
        end_s = time.monotonic() + self._limits.max_request_s
        for attempt, delay_s in enumerate((*RETRY_DELAYS_S, None), 1):
            try:
                return action()
            except RecordingError:
                raise
            except Exception as err:  # any library below may raise
                if is_short_memory(err):
                    raise
                fault = fault_of(err)
                if fault.passes and delay_s is not None and time.monotonic() + delay_s < end_s:
                    time.sleep(delay_s)
                    continue
                reason = f"{failed} ({fault.reason}, {attempt} attempts)" if fault.passes else fault.reason
                # Not from err: the libraries quote the whole URL, including secrets.
                raise RecordingError(f"{self.path}: {reason}; {fault.remedy}") from None
        raise RuntimeError("unreachable: the last attempt returns or raises")

    def _disconnect(self) -> None:
        if self._opened is not None:
            self._opened.close()
        self._opened = None


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


def open_remote(path: RemotePath, limits: LimitsConfig = DEFAULT_LIMITS) -> tuple[RemotePath, BinaryIO]:
    """Open a file on a server; returns its path with the facts that the server told, and a stream.

    Raises:
        RecordingError: it cannot be read; says why.
    """
    remote = RemoteFile(path, limits)
    return remote.path, cast("BinaryIO", remote)


def tell_full_read(stream: BinaryIO, because: str) -> None:
    """Warn that the whole file will be fetched, and fetch it in large parts; does nothing for a local file."""
    if remote := _remote(stream):
        remote.fetch_ahead()
        logger.warning("%s: %s: all of it is fetched, %.1f MB", remote.path, because, remote.size / 1e6)


def _remote(stream: object) -> RemoteFile | None:
    return stream if isinstance(stream, RemoteFile) else None


def _runs(pages: Iterable[int], most: int) -> Iterator[tuple[int, int]]:
    """First page and the one after the last of each run of adjacent pages, each one request; in the order given."""
    first = last = -1
    for page in pages:
        if page != last or last - first == most:
            if last > first:
                yield first, last
            first = page
        last = page + 1
    if last > first:
        yield first, last


def _opened(path: RemotePath, limits: LimitsConfig) -> "_Opened":
    """The file, opened by our own client or by fsspec's for its protocol.

    Raises:
        RecordingError: the protocol is unknown, or what it needs is not installed.
        Exception: of the client, if it cannot be reached.
    """
    try:
        if path.protocol in {"http", "https"}:
            from readers.files.web import WebFile  # needs aiohttp and fsspec, which are optional

            return _of_web(WebFile(path, max_request_s=limits.max_request_s))
        import fsspec

        options: dict[str, Any] = {"skip_instance_cache": True}
        if path.protocol in {"s3", "s3a"}:
            options["use_listings_cache"] = False
        kind = fsspec.get_filesystem_class(path.protocol)
    except ImportError:
        if extra := EXTRAS.get(path.protocol):
            remedy = f"install it with `pip install 'lidcam[{extra}]'`"
        else:
            remedy = f"install what fsspec needs for it, or {REMEDY}"
        raise RecordingError(f"{path}: reading {path.protocol}:// is not installed; {remedy}") from None
    except ValueError as err:
        if path.protocol in {"http", "https"}:
            raise
        raise RecordingError(f"{path}: lidcam reads https://, http:// and s3://, found {path.protocol}://") from err
    return _of_fsspec(path, kind(**kind._get_kwargs_from_urls(path.url), **options), kind)


class _Opened(NamedTuple):
    """A file on a server.

    Attributes:
        size: Bytes.
        facts: What the server says of its version, by name.
        read: Its bytes from one place to before another.
        close: Ends the connection.
    """

    size: int
    facts: tuple[tuple[str, str], ...]
    read: Callable[[int, int], bytes]
    close: Callable[[], None]


def _of_web(file: "WebFile") -> _Opened:
    try:
        found = file.facts()
    except BaseException:
        file.close()
        raise
    if found.size is None or not found.has_ranges:
        file.close()
        raise ServerError(NO_SIZE if found.size is None else NO_RANGES)
    facts = {"size": str(found.size), "etag": found.etag, "last_modified": found.modified}
    return _Opened(found.size, _shown(facts), file.read, file.close)


def _of_fsspec(path: RemotePath, system: Any, kind: Any) -> _Opened:
    """S3, and whatever else fsspec knows; it makes sure by itself that all parts are of the same file."""
    place = str(kind._strip_protocol(path.url))  # url_to_fs would take "::" for a chain of file systems
    info = system.info(place)
    if info.get("type") == "directory":
        raise RecordingError(f"{path}: expected a file, found a folder; name the .mcap files in it")
    if not isinstance(info.get("size"), int):
        raise ServerError(NO_SIZE)
    file = system.open(place, "rb", cache_type="none") if info["size"] else BytesIO()

    def read(start: int, stop: int) -> bytes:
        file.seek(start)
        return bytes(file.read(stop - start))

    def close() -> None:
        file.close()
        session = getattr(system, "_s3creator", None)
        if session is not None:
            system.close_session(system.loop, session)

    known = {"etag": ("ETag", "etag"), "last_modified": ("LastModified",)}
    facts = {name: next((str(info[key]) for key in keys if info.get(key)), "") for name, keys in known.items()}
    return _Opened(info["size"], _shown({"size": str(info["size"]), **facts}), read, close)


def _shown(facts: dict[str, str]) -> tuple[tuple[str, str], ...]:
    return tuple((name, value[:MAX_FACT_CHARACTERS]) for name, value in facts.items() if value and value.isprintable())
