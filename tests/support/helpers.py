"""What several tests share."""

import json
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from lidcam.pipeline.core.arrays import F32, F64

MIB = 1 << 20
ROOT = Path(__file__).resolve().parents[2]
BAGS = ROOT / "bags"
SANDBOX, CROSSING = BAGS / "sandbox.bag", BAGS / "crossing.mcap"
CLUSTERS = "detect3d.method=cluster"
"""The setting of runs that do not test detection: the network of the default takes longer than all the rest."""


def shared(path: str) -> Path:
    """A file of the `shared` folder that lies beside the checkout; skips the test where it is absent."""
    for parent in Path(__file__).resolve().parents:
        candidate = parent / "shared" / path
        if candidate.exists():
            return candidate
    pytest.skip(f"needs shared/{path} beside the checkout")


@contextmanager
def at_most(mib: float) -> Iterator[None]:
    """Hold the block to an amount of memory."""
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < mib * MIB, f"{peak / MIB:.1f} MiB"


def oracle_cloud(scene: str) -> tuple[F32, F64]:
    """The combined cloud of the predecessor system, lidars shifted in float32, and their origins."""
    folder = shared(f"oracles/combiner/{scene}")
    offsets = np.array(json.loads((folder / "scene.json").read_text())["offsets"])
    names = ("lidar11", "lidar12", "lidar2")
    parts = [np.fromfile(folder / f"{name}.bin", "<f4").reshape(-1, 4)[:, :3] for name in names]
    shifted = [part + offset.astype(np.float32) for part, offset in zip(parts, offsets, strict=True)]
    return np.concatenate(shifted), offsets
