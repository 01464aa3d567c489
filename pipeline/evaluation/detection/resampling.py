"""Figures of resampled recordings, for intervals: the bootstrap over blocks of neighbouring frames.

Neighbouring frames share objects and errors; drawn one by one, they would give intervals that are far too narrow. So
blocks of about a second are drawn with replacement (Carlstein, The use of subseries values for estimating the variance
of a general statistic from a stationary sequence, Annals of Statistics 14, 1986). Fewer than ten blocks still give
intervals that are too narrow.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, Bools, Indices
from lidcam.pipeline.evaluation.detection.curves import average_precision, last_of_equals

SAMPLES = 1000
"""Samples drawn for intervals of 95 %."""

_BLOCK_NS = 1_000_000_000
_MAX_BLOCKS = 1000
"""Largest number of blocks; those of long recordings are longer."""

_MAX_POINTS = 256
"""Scores at which the curve of a sample is read, evenly spread over the right detections."""

_SEED = 0


@dataclass(frozen=True, eq=False)
class Resampling:
    """Samples of a recording, as weights of blocks of frames."""

    blocks: I64  # (F,) int64, block of each frame
    weights: F64  # (S, B) float64, times that a sample holds a block; a sample holds B blocks

    @classmethod
    def of(cls, stamps_ns: I64) -> "Resampling":
        """Samples of the frames at times (F,), at least one; always the same."""
        since_ns = stamps_ns - stamps_ns.min()
        length_ns = max(_BLOCK_NS, -(-(int(since_ns.max()) + 1) // _MAX_BLOCKS))
        _, blocks = np.unique(since_ns // length_ns, return_inverse=True)
        count = int(blocks.max()) + 1
        draws = np.random.default_rng(_SEED).multinomial(count, np.full(count, 1 / count), size=SAMPLES)
        return cls(blocks.astype(np.int64), draws.astype(np.float64))

    @property
    def block_count(self) -> int:
        """Number of blocks, B."""
        return int(self.weights.shape[1])

    @cached_property
    def distinct(self) -> tuple[Indices, Indices]:
        """Rows of distinct samples, and (S,) the place among them of each sample; short recordings have few."""
        _, first, same = np.unique(self.weights, axis=0, return_index=True, return_inverse=True)
        return first, same.reshape(-1)

    def sums(self, frames: I32, values: F64 | None = None) -> F64:
        """(S,) sum over each sample of values (R,), or of 1, that stand in the given frames (R,)."""
        by_block = np.bincount(self.blocks[frames], values, self.block_count)
        # no matrix product: its order of summation, which does not matter for counts, differs from machine to machine
        return np.asarray((self.weights * by_block).sum(1))

    def running_sums(self, frames: I32, counted: Bools, ends: Indices) -> F64:
        """(S, P) number of counted rows (N,) before each end (P,), in each sample; ends rise."""
        parts = np.searchsorted(ends, np.flatnonzero(counted), side="right")
        inside = parts < len(ends)
        cells = self.blocks[frames[counted][inside]] * len(ends) + parts[inside]
        table = np.bincount(cells, minlength=self.block_count * len(ends)).reshape(self.block_count, len(ends))
        return np.cumsum(self.weights @ table.astype(np.float64), axis=1)


def sampled_ap(resampling: Resampling, frames: I32, scores: F32, is_right: Bools, truth_frames: I32) -> F64:
    """(S,) average precision by overlap at 40 recalls of each sample; NaN without true objects.

    Of the detections (N,) that count, by falling score, and of true objects (T,) by their frames.
    """
    last = last_of_equals(scores)
    # precision is highest where a right detection has just come in
    gains = np.diff(np.cumsum(is_right)[last], prepend=0) > 0
    ends = last[gains] + 1
    ends = ends[np.linspace(0, len(ends) - 1, min(len(ends), _MAX_POINTS)).round().astype(np.intp)]
    right = resampling.running_sums(frames, is_right, ends)
    all_found = resampling.running_sums(frames, np.ones(len(frames), np.bool_), ends)
    quality = np.divide(right, all_found, out=np.zeros(right.shape), where=all_found > 0)
    counts = np.rint(right).astype(np.int64)
    truth = np.rint(resampling.sums(truth_frames)).astype(np.int64)
    rows, same = resampling.distinct
    values = [average_precision(counts[row], quality[row], int(truth[row])) for row in rows.tolist()]
    return np.array([np.nan if value is None else value for value in values])[same]
