"""A file on a web server: its size and its parts, by requests whose answers are held to what was asked for.

A server may send anything: more than was asked for and without end, compressed, a byte every few seconds, another part
or another file. So every answer is read in pieces, counted, and given a time in all; its headers are compared with the
request, and with what was known when the file was opened (RFC 9110, 13 and 14).
"""

import asyncio
import re
from collections.abc import Coroutine
from typing import Any, NamedTuple, TypeVar

import aiohttp
from fsspec.asyn import get_loop
from yarl import URL

from readers.files.remote_faults import CHANGED, NO_RANGES, REMEDY, UNUSABLE, Fault, ServerError, fault_of_status
from readers.location import RemotePath

__all__ = ["WebFacts", "WebFile"]

T = TypeVar("T")

SILENCE_S = 30.0
"""A server that sends nothing for this long counts as a lost connection."""

MAX_REDIRECTS = 5
PIECE = 1 << 16
CONTENT_RANGE = re.compile(r"bytes (?:(\d{1,19})-(\d{1,19})|\*)/(\d{1,19}|\*)")
HEADERS = {"Accept-Encoding": "identity"}
NO_CONTENT_CODING = frozenset({"", "identity"})

COMPRESSES = Fault("its server compresses what it sends, though it was asked not to", REMEDY)
OTHER_PART = Fault("its server answers with another part than it was asked for", REMEDY)
TOO_MUCH = Fault("its server sends more than it was asked for", REMEDY)
TOO_LITTLE = Fault("its server sends less than it was asked for", "check the network, and try again", passes=True)


class WebFacts(NamedTuple):
    """What a server says about a file.

    Attributes:
        size: Bytes; None if it does not say.
        etag: Its version; empty if the server names none.
        modified: When it was changed; empty likewise.
        has_ranges: Whether parts can be fetched, as far as the server says.
    """

    size: int | None
    etag: str
    modified: str
    has_ranges: bool

    @property
    def conditions(self) -> dict[str, str]:
        """Headers that make sure that a part is of the same file."""
        if self.etag.startswith('"'):  # weak ones never match
            return {"If-Match": self.etag}
        return {"If-Unmodified-Since": self.modified} if self.modified else {}


class WebFile:
    """A file on a web server.

    Args:
        path: Its location.
        max_request_s: What one request may take.

    Raises:
        ServerError: its address cannot be used.
    """

    def __init__(self, path: RemotePath, *, max_request_s: float) -> None:
        is_encoded = path.url.isascii() and " " not in path.url  # a signed URL must not change
        try:
            self._url = URL(path.url, encoded=is_encoded)
        except ValueError as err:
            raise ServerError(UNUSABLE) from err
        self._max_request_s = max_request_s
        self._loop = get_loop()
        self._facts = WebFacts(None, "", "", has_ranges=True)
        self._session: aiohttp.ClientSession = self._wait(self._connected())

    def facts(self) -> WebFacts:
        """What the server says about the file; parts read later have to be of the same one.

        Raises:
            ServerError: it gives no answer that can be used.
            aiohttp.ClientError: it cannot be reached.
        """
        self._facts = self._wait(self._asked())
        return self._facts

    def read(self, start: int, stop: int) -> bytes:
        """The bytes from `start` to before `stop`.

        Raises:
            ServerError: the answer is something else.
            aiohttp.ClientError: the connection fails.
        """
        return self._wait(self._part(start, stop))

    def close(self) -> None:
        """Close the connections."""
        self._wait(self._session.close())

    def _wait(self, work: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    async def _connected(self) -> aiohttp.ClientSession:
        silence_s = min(SILENCE_S, self._max_request_s)
        timeout = aiohttp.ClientTimeout(total=self._max_request_s, sock_connect=silence_s, sock_read=silence_s)
        return aiohttp.ClientSession(timeout=timeout, trust_env=True, auto_decompress=False)  # HTTPS_PROXY

    def _request(self, method: str, headers: dict[str, str]) -> Any:
        return self._session.request(method, self._url, headers=HEADERS | headers, max_redirects=MAX_REDIRECTS)

    async def _asked(self) -> WebFacts:
        """By HEAD, or, where that is refused, as of links that are signed for GET, by the first byte."""
        try:
            async with self._request("HEAD", {}) as answer:
                if answer.status < 400 and (facts := _facts(answer)).size is not None:
                    return facts
        except (aiohttp.ClientResponseError, aiohttp.ClientPayloadError):
            pass
        async with self._timed(self._request("GET", {"Range": "bytes=0-0"})) as answer:
            if answer.status >= 400 and answer.status != 416:
                raise ServerError(fault_of_status(answer.status))
            return _facts(answer)

    async def _part(self, start: int, stop: int) -> bytes:
        wanted = {"Range": f"bytes={start}-{stop - 1}", **self._facts.conditions}
        async with self._timed(self._request("GET", wanted)) as answer:
            self._check(answer, start, stop)
            data = bytearray()
            async for piece in answer.content.iter_chunked(PIECE):
                if len(data) + len(piece) > stop - start:
                    raise ServerError(TOO_MUCH)
                data += piece
        if len(data) < stop - start:
            raise ServerError(TOO_LITTLE)
        return bytes(data)

    def _check(self, answer: aiohttp.ClientResponse, start: int, stop: int) -> None:
        """Refuse an answer that is not the part of the file that was asked for.

        Raises:
            ServerError: it is not.
        """
        known = self._facts
        if answer.status not in {200, 206}:
            raise ServerError(fault_of_status(answer.status))
        if answer.headers.get("Content-Encoding", "").strip().lower() not in NO_CONTENT_CODING:
            raise ServerError(COMPRESSES)
        found = _facts(answer)
        if (known.etag and found.etag not in {"", known.etag}) or (
            known.modified and found.modified not in {"", known.modified}
        ):
            raise ServerError(CHANGED)
        if answer.status == 200:
            if start or (found.size is not None and found.size != stop):
                raise ServerError(NO_RANGES)
            return
        match = CONTENT_RANGE.fullmatch(answer.headers.get("Content-Range", "").strip())
        if match is not None and match[3] not in {"*", str(known.size)}:
            raise ServerError(CHANGED)
        if match is None or match[1] is None or (int(match[1]), int(match[2])) != (start, stop - 1):
            raise ServerError(OTHER_PART)

    def _timed(self, request: Any) -> "_Timed":
        return _Timed(request, self._max_request_s)


class _Timed:
    """A request that says it where its whole time is up, which is no silence: asking again would take as long."""

    def __init__(self, request: Any, max_request_s: float) -> None:
        self._request, self._max_request_s = request, max_request_s

    async def __aenter__(self) -> aiohttp.ClientResponse:
        try:
            answer: aiohttp.ClientResponse = await self._request.__aenter__()
        except Exception as err:
            self._tell(err)
            raise
        return answer

    async def __aexit__(self, kind: Any, err: BaseException | None, traceback: Any) -> None:
        await self._request.__aexit__(kind, err, traceback)
        if err is not None:
            self._tell(err)

    def _tell(self, err: BaseException) -> None:
        if isinstance(err, TimeoutError) and not isinstance(err, aiohttp.ServerTimeoutError):
            reason = f"its server took more than {self._max_request_s:g} s for one request"
            raise ServerError(Fault(reason, f"{REMEDY}, or raise limits.max_request_s")) from err


def _facts(answer: aiohttp.ClientResponse) -> WebFacts:
    headers = answer.headers
    match = CONTENT_RANGE.fullmatch(headers.get("Content-Range", "").strip())
    length = headers.get("Content-Length", "")
    size: int | None = None
    if match is not None and answer.status in {206, 416}:
        size = None if match[3] == "*" else int(match[3])
    elif (
        answer.status == 200
        and length.isdecimal()
        and headers.get("Content-Encoding", "").strip().lower() in NO_CONTENT_CODING
    ):
        size = int(length[:19])
    has_ranges = headers.get("Accept-Ranges", "").strip().lower() != "none"
    return WebFacts(size, headers.get("ETag", ""), headers.get("Last-Modified", ""), has_ranges)
