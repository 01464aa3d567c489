"""Locations of recordings: a local path, or a URL whose credentials are never shown."""

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.urls import MORE, shown_url

URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://(.*)", re.DOTALL)


@dataclass(frozen=True, slots=True, repr=False)
class RemotePath:
    """A file on a server. Its text form leaves out all secrets."""

    url: str  # The whole URL, including secrets (user and password, the signature in a query): never show it
    # Facts that the server gave when the file was opened: `size` in bytes, `etag`, `last_modified`
    facts: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        return shown_url(self.url)

    def __repr__(self) -> str:
        return f"RemotePath({str(self)!r})"

    @property
    def protocol(self) -> str:
        """Protocol of the URL, in lower case."""
        return _parts(self.url)[0]

    @property
    def name(self) -> str:
        """Name of the file."""
        return PurePosixPath(str(self).removesuffix(MORE).partition("://")[2]).name


Location = Path | RemotePath

ENDINGS = (".bag", ".mcap", ".db3", ".pcap", ".pcapng", ".bag.zst", ".mcap.zst", ".db3.zst")
"""Endings of the names of recordings."""


def recording_stem(name: str) -> str:
    """The name of a recording without its ending."""
    lower = name.lower()
    ending = max((one for one in ENDINGS if lower.endswith(one)), key=len, default="")
    return name[: len(name) - len(ending)] or name


def location(text: str) -> Location:
    """The location that a command line argument names: a URL (`https://...`, `s3://...`), or a path, also `file://`.

    `.` and `..`, which have no name, are the folders that they stand for.

    Raises:
        RecordingError: it is empty, as of a variable that is not set; as a path, that is the folder that one is in.
    """
    if not text:
        raise RecordingError("expected a path or a URL, found an empty name; is a variable not set?")
    if URL.match(text) is None:
        path = Path(text)
        return path.resolve() if path.name in {"", ".."} else path
    protocol, rest = _parts(text)
    if protocol == "file":
        return Path(unquote(urlsplit(text).path))
    return RemotePath(f"{protocol}://{rest}")


def _parts(url: str) -> tuple[str, str]:
    match = URL.match(url)
    if match is None:
        raise ValueError("expected a URL with a protocol, as https://host/path")
    return match[1].lower(), match[2]
