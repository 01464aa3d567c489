"""Ids of objects as whole numbers: a recording may call them by names."""

from functools import lru_cache
from hashlib import blake2b

import numpy as np

from lidcam.pipeline.core.arrays import I64, Names
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN

_MAX_DIGITS = 18
_OF_NAMES = 1 << 62
"""Set in the numbers of ids that are names, so that no recorded number is one of them."""


def track_ids(ids: Names) -> I64:
    """(N,) the numbers of ids: a number is itself, a name gets one of its own; `UNKNOWN` where the id is empty."""
    return np.array([_track_id(id_) for id_ in ids.tolist()], np.int64).reshape(-1)


@lru_cache(maxsize=65_536)
def _track_id(id_: str) -> int:
    if not id_:
        return UNKNOWN
    if id_.isascii() and id_.isdecimal() and len(id_) <= _MAX_DIGITS:
        return int(id_)
    digest = int.from_bytes(blake2b(id_.encode(errors="replace"), digest_size=8).digest(), "big")
    return digest % _OF_NAMES | _OF_NAMES
