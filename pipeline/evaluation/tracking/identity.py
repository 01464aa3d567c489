"""Identity measures: how much of the truth is found under one name.

Ristani et al., "Performance measures and a data set for multi-target, multi-camera tracking", ECCV workshops, 2016.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.evaluation.tracking.table import TrackTable


@dataclass(frozen=True, slots=True)
class IdentityCounts:
    """Counts of matches if each true track has at most one track found for all of its time."""

    truth: int  # True objects in all frames
    found: int  # Boxes found in all frames
    matches: int  # Of both, those in frames in which the two tracks of a pair are near each other


def count_identity(table: TrackTable) -> IdentityCounts:
    """The counts of one class, of the pairs of tracks with the most matches."""
    near = table.pairs.distances_m < table.max_distance_m
    tracks = table.truth.tracks[table.pairs.truth[near]], table.found.tracks[table.pairs.found[near]]
    pairs, counts = np.unique(np.stack(tracks, 1), axis=0, return_counts=True)
    return IdentityCounts(len(table.truth), len(table.found), _most(pairs, counts))


def _most(pairs: I64, counts: I64) -> int:
    """The largest sum of counts of pairs of which each track is part of one at most.

    Over a long recording nearly all tracks are joined by pairs, so that a matrix of all with all would not fit in
    memory. Each true track has a stand-in for "none" instead, and the problem stays sparse (Jonker and Volgenant, "A
    shortest augmenting path algorithm for dense and sparse linear assignment problems", Computing 38, 1987).
    """
    if not len(pairs):
        return 0
    from scipy.sparse import csr_array  # a fifth of a second: behind the imports of the programs
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    truth, row_of = np.unique(pairs[:, 0], return_inverse=True)
    found, column_of = np.unique(pairs[:, 1], return_inverse=True)
    nobody = np.arange(len(truth))
    # The solver takes a weight of 0 for no pair: all weights are 1 higher, which changes no order.
    weights = np.concatenate([counts, np.zeros(len(truth))]) + 1.0
    rows, columns = np.concatenate([row_of, nobody]), np.concatenate([column_of, nobody + len(found)])
    graph = csr_array((weights, (rows, columns)), shape=(len(truth), len(truth) + len(found)))
    chosen = min_weight_full_bipartite_matching(graph, maximize=True)
    return int(graph[chosen].sum()) - len(truth)


def identity_figures(counts: IdentityCounts) -> dict[str, float | None]:
    """IDF1, precision and recall; None where there is nothing to measure."""
    both = counts.truth + counts.found
    return {
        "idf1": 2 * counts.matches / both if both else None,
        "idp": counts.matches / counts.found if counts.found else None,
        "idr": counts.matches / counts.truth if counts.truth else None,
    }
