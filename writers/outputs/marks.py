"""Marks by which lidcam recognises its own files: a run replaces those of earlier runs, and no others.

A text carries its checksum, so that a text that somebody has edited is not replaced.
"""

import re
from hashlib import sha256

LIBRARY = "lidcam"
"""In the header of an MCAP. Without a version: the same results have the same bytes whichever version of the MCAP
library wrote them."""

RESULT = "lidcam"
REPAIRED = "lidcam.repair"
SIMULATED = "lidcam_truth"
"""Names of metadata records of an MCAP: a result, a repaired recording, a simulated one."""

INPUTS = "lidcam.inputs"
"""Metadata record of a result with the checksums of its inputs, known when all of them were read."""

APPLICATION = "lidcam"
"""Application of an .rrd."""

OBJECTS = "lidcam.objects"
"""Key in the metadata of a Parquet table of objects."""

MATCHES = "lidcam.matches"
"""Begins the comment of an image of a camera."""

FILM = "lidcam.film"
"""Begins the comment of a film."""

PAGE = '<meta name="generator" content="lidcam">'
"""In the head of a page about a result."""

BAG_CALLER = "/lidcam_simulator"
"""The node that publishes all topics of a simulated ROS 1 bag."""

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
