"""Binary PCD files of single objects: read by CloudCompare, Open3D and PCL.

The second line of the header, a comment to them, says which object it is, and by it a file is known as lidcam's. It is
what a run needs to go on with a file, too.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32
from lidcam.writers.outputs.marks import OBJECT_CLOUD

FIELDS = "x y z intensity time"
COUNT = len(FIELDS.split())
MARK = f"# {OBJECT_CLOUD} "
PCD_HEAD = f"# .PCD v0.7 - Point Cloud Data file format\n{MARK}"
"""How these files begin."""


class PcdFacts(NamedTuple):
    """The facts of an object in the header of its file.

    Attributes:
        track: Number of its track.
        label: Name of its class.
        size_m: Length, width and height of its box, whose centre is the origin.
        stamp_ns: Origin of the times.
        voxel_m: Side of the voxels, of which each has one point at most.
    """

    track: int
    label: str
    size_m: tuple[float, ...]
    stamp_ns: int
    voxel_m: float


def write_pcd(path: Path, facts: PcdFacts, points: F32) -> None:
    """Write points (N, 5): x, y, z, intensity, time; a file that stands there is replaced.

    Raises:
        OSError: it cannot be written.
    """
    count = len(points)
    header = (
        f"{PCD_HEAD}{json.dumps(facts._asdict())}\n"
        f"VERSION 0.7\nFIELDS {FIELDS}\nSIZE{' 4' * COUNT}\nTYPE{' F' * COUNT}\nCOUNT{' 1' * COUNT}\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def read_pcd(path: Path) -> tuple[PcdFacts, F32]:
    """The content of a file that `write_pcd` has written.

    Raises:
        OSError: it cannot be read.
    """
    header, _, data = path.read_bytes().partition(b"\nDATA binary\n")
    tree: dict[str, Any] = json.loads(header.splitlines()[1][len(MARK) :])
    facts = PcdFacts(**tree | {"size_m": tuple(tree["size_m"])})
    return facts, np.frombuffer(data, "<f4").reshape(-1, COUNT).astype(np.float32)
