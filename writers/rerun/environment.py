"""Variables of the environment that change what Rerun writes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_rerun_variables() -> Iterator[None]:
    """Within the block there are none: `RERUN=off` would write nothing, `RERUN_FLUSH_NUM_BYTES` other bytes."""
    kept = {name: os.environ.pop(name) for name in [*os.environ] if name.startswith("RERUN")}
    try:
        yield
    finally:
        os.environ.update(kept)
