"""Chains: the boxes of one object, in the order of time."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, Rows, check_array, select_rows
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.evaluation.headings import is_flip
from pipeline.evaluation.unlabelled.linking import MAX_GAP_FRAMES

__all__ = ["ChainTable", "chain_figures", "steps_within"]


@dataclass(frozen=True, slots=True, eq=False)
class ChainTable:
    """Boxes of chains, ordered by chain, then by frame; a chain is in a frame at most once.

    Attributes:
        chains: (N,) int64, numbers from 0 without gaps.
        frames: (N,) int64.
        stamps_ns: (N,) int64.
        xy: (N, 2) float64, centre, metres.
        sizes: (N, 3) float64, metres.
        yaws: (N,) float64.
        class_ids: (N,) int64.
    """

    chains: I64
    frames: I64
    stamps_ns: I64
    xy: F64
    sizes: F64
    yaws: F64
    class_ids: I64

    def __post_init__(self) -> None:
        n = len(self.chains)
        for name in ("chains", "frames", "stamps_ns", "class_ids"):
            check_array(name, getattr(self, name), (n,), np.int64)
        check_array("xy", self.xy, (n, 2), np.float64)
        check_array("sizes", self.sizes, (n, 3), np.float64)
        check_array("yaws", self.yaws, (n,), np.float64)

    def __len__(self) -> int:
        return len(self.chains)

    @classmethod
    def empty(cls) -> "ChainTable":
        """No boxes."""
        none = np.zeros(0, np.int64)
        return cls(none, none, none, np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0), none)

    @property
    def count(self) -> int:
        """Number of chains."""
        return int(self.chains.max(initial=-1)) + 1

    def main_classes(self) -> I64:
        """(K,) the class that most boxes of each chain have; of equally many the first of the settings."""
        if not len(self):
            return np.zeros(0, np.int64)
        counts = np.zeros((self.count, int(self.class_ids.max()) + 1), np.int64)
        np.add.at(counts, (self.chains, self.class_ids), 1)
        return np.asarray(counts.argmax(1), np.int64)

    def of_chains(self, wanted: Bools) -> "ChainTable":
        """The chains (K,) that are wanted, numbered anew."""
        part = self.select(wanted[self.chains])
        return replace(part, chains=(np.cumsum(wanted) - 1)[part.chains])

    def select(self, rows: Rows) -> "ChainTable":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)


def steps_within(table: ChainTable) -> Bools:
    """(N - 1,) whether a row and the next one are of one chain."""
    return np.asarray(np.diff(table.chains) == 0)


def chain_figures(table: ChainTable) -> dict[str, float | int | None]:
    """How long chains are, and what changes within them; None where there is nothing to measure."""
    lengths = np.bincount(table.chains)
    first, last = np.cumsum(lengths) - lengths, np.cumsum(lengths) - 1
    seconds = (table.stamps_ns[last] - table.stamps_ns[first]) / 1e9
    spans = table.frames[last] - table.frames[first] + 1
    same = steps_within(table)
    missing = np.diff(table.frames)[same] - 1
    turns_rad = wrap_angle(np.diff(table.yaws))
    several = lengths >= 2
    spread = _spread(table.sizes, table.chains, lengths)[several]
    return {
        "chains": len(lengths),
        "frames_mean": _mean(lengths),
        "frames_median": _median(lengths),
        "seconds_mean": _mean(seconds),
        "seconds_median": _median(seconds),
        "single_frame_share": _mean(~several),
        "flickers": int(((missing > 0) & (missing <= MAX_GAP_FRAMES)).sum()),
        "missing_share": float(1 - lengths.sum() / spans.sum()) if len(lengths) else None,
        "class_changes": int((same & (np.diff(table.class_ids) != 0)).sum()),
        "heading_flips": int((same & is_flip(turns_rad)).sum()),
        "length_spread": _mean(spread[:, 0]),
        "width_spread": _mean(spread[:, 1]),
        "height_spread": _mean(spread[:, 2]),
    }


def _spread(sizes: F64, chains: I64, lengths: I64) -> F64:
    """(K, 3) standard deviation of the size in each chain, over its mean."""
    columns = []
    for size in sizes.T:
        mean = np.bincount(chains, size) / lengths
        variance = np.bincount(chains, (size - mean[chains]) ** 2) / lengths
        columns.append(np.sqrt(variance) / np.where(mean > 0, mean, 1.0))
    return np.stack(columns, 1)


def _mean(values: F64 | I64 | Bools) -> float | None:
    return float(values.mean()) if len(values) else None


def _median(values: F64 | I64) -> float | None:
    return float(np.median(values)) if len(values) else None
