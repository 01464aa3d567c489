"""The page of a batch: a row for each recording, with an image of its busiest moment and links to its results."""

import base64
import re
from collections.abc import Sequence
from pathlib import PurePosixPath
from urllib.parse import quote

import cv2
import numpy as np

from lidcam.batches.jobs import INDEX
from lidcam.batches.records import JobRecord
from lidcam.batches.store import LocalFiles, Store
from lidcam.pipeline.core.errors import OutputError
from lidcam.writers.outputs.marks import PAGE
from lidcam.writers.report.page import index_page

THUMBNAIL_PX = 240
"""Width of the image of a recording, pixels."""

HEAD_BYTES = 4 << 20
"""Maximum size of the head of a report in which that image is looked for."""

LINKS = {".html": "report", ".rrd": "Rerun", ".mcap": "MCAP", ".mp4": "film", ".parquet": "objects"}
"""Names of the links to results, by the ending of the file."""

_IMAGE = re.compile(rb'<div class="busiest">\s*<figure[^>]*><img src="data:image/jpeg;base64,([^"]+)"')


def index_of(records: Sequence[JobRecord], totals: str, store: Store) -> bytes:
    """The page, as HTML.

    Args:
        records: The recordings, in order.
        totals: A line about all of them.
        store: The results; the images are those of local reports.
    """
    return index_page([_row(one, store) for one in records], totals).encode()


def keep_index(content: bytes, store: Store) -> bool:
    """Write the page beside the results; returns whether it was written: a page of somebody else's stays."""
    try:
        known = store.files.read(INDEX)
    except (OSError, OutputError):  # too large to be ours, or no plain file
        return False
    if known is not None and PAGE.encode() not in known[:4096]:
        return False
    with store.held("", is_awaited=True):
        store.files.put(INDEX, content)
    return True


def _row(record: JobRecord, store: Store) -> dict[str, object]:
    names = {PurePosixPath(name).suffix: name for name in record.outputs or {}}
    users = record.road_users
    return {
        "name": record.name,
        "state": record.shown_state,
        "message": record.message,
        "frames": record.frames or "",
        "users": "" if users is None else ", ".join(f"{count} {name}" for name, count in users.items()),
        "dropped": record.dropped or "",
        "links": [(label, quote(names[ending])) for ending, label in LINKS.items() if ending in names],
        "thumbnail": _thumbnail(names[".html"], store) if ".html" in names else "",
    }


def _thumbnail(report: str, store: Store) -> str:
    """The image of the busiest moment in a report, small, as a data URI; empty without one at hand."""
    if not isinstance(store.files, LocalFiles):
        return ""
    with store.files.at(report).open("rb") as file:
        found = _IMAGE.search(file.read(HEAD_BYTES))
    image = cv2.imdecode(np.frombuffer(base64.b64decode(found[1]), np.uint8), cv2.IMREAD_COLOR) if found else None
    if image is None:
        return ""
    size_px = THUMBNAIL_PX, max(round(THUMBNAIL_PX * image.shape[0] / image.shape[1]), 1)
    _, jpeg = cv2.imencode(".jpg", cv2.resize(image, size_px, interpolation=cv2.INTER_AREA))
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg.tobytes()).decode()}"
