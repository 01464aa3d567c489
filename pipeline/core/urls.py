"""URLs, shown without secrets: no user, no password, no query."""

import re

MORE = "?..."
"""In place of a query or a fragment."""

_NAME = r"[A-Za-z][A-Za-z0-9+.-]"
_ANY_NAME = r"[^\s/:@'\"(=,\[]*"
"""Name of a protocol, also a mistyped one, which counts only if a user or a password may follow."""

_URL = re.compile(rf"({_NAME}+(?=:/)|[A-Za-z](?=://)|{_ANY_NAME}(?=:/.*@)):(/+)(.*)", re.DOTALL)
_STARTS = re.compile(
    rf"(?<![^\s'\"(=,\[])(?={_NAME}*:/|{_ANY_NAME}:(?:/\S*|//.*)@)"
    rf"|(?<=/)(?=(?:https?|ftps?|s3|gs|gcs|abfss?|az):/|{_ANY_NAME}:/\S*@)",
    re.IGNORECASE,
)
_PART = re.compile(r"((?:.*@)?\S*?)(['\")\]]*[:,;]?(?:\s.*)?)", re.DOTALL)


def shown_url(url: str) -> str:
    """A URL without its secrets; `https://...` where a password may hold a slash or the like. Other texts stay."""
    found = _URL.fullmatch(url)
    if found is None:
        return url
    protocol, slashes, rest = found.groups()
    start = f"{protocol.lower()}:{slashes}"
    shown, *more = re.split(r"[?#]", rest, maxsplit=1)
    authority, slash, path = shown.partition("/")
    host = authority.rpartition("@")[2]
    port = host.rpartition("]")[2].partition(":")[2]
    if (port and not port.isdigit()) or (":" in host and "@" in rest.removeprefix(authority)):
        return f"{start}..."
    return f"{start}{host}{slash}{path}{MORE if more else ''}"


def without_secrets(text: str) -> str:
    """A line of text with every URL in it as `shown_url` shows it; also one that `pathlib` left a single slash."""
    if ":/" not in text:
        return text
    return "".join(_shown_part(part) for part in _STARTS.split(text))


def _shown_part(part: str) -> str:
    found = _URL.match(part)
    if found is None:
        return part
    rest = _PART.fullmatch(found[3])
    assert rest is not None  # it takes any text
    return shown_url(f"{found[1]}:{found[2]}{rest[1]}") + rest[2]
