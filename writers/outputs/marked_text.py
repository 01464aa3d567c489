"""Text files that say whether they are still as lidcam wrote them: those that people edit are not replaced."""

import re
from hashlib import sha256

__all__ = ["is_unchanged_text", "marked_json", "marked_yaml"]

_YAML = "# Written by lidcam, which replaces it as long as it is unchanged (sha256 {digest}).\n"
_JSON = '{{\n  "lidcam": "sha256 {digest}",\n'
_MARKS = [
    re.compile(re.escape(mark.format(digest="DIGEST")).replace("DIGEST", "([0-9a-f]{64})")) for mark in (_YAML, _JSON)
]


def marked_yaml(text: str) -> str:
    """YAML with a first line that has its checksum."""
    return _YAML.format(digest=_digest(text)) + text


def marked_json(text: str) -> str:
    """An indented JSON object with a first key that has its checksum."""
    rest = text.removeprefix("{\n")
    return _JSON.format(digest=_digest(rest)) + rest


def is_unchanged_text(text: str) -> bool:
    """Whether lidcam wrote a text, and nobody has changed it."""
    for mark in _MARKS:
        if found := mark.match(text):
            return found[1] == _digest(text[found.end() :])
    return False


def _digest(text: str) -> str:
    return sha256(text.encode(errors="surrogatepass")).hexdigest()
