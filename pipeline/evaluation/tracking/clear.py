"""CLEAR MOT, and how much of the truth is found under one name.

Bernardin and Stiefelhagen, "Evaluating multiple object tracking performance", EURASIP JIVP, 2008; identity measures:
Ristani et al., "Performance measures and a data set for multi-target, multi-camera tracking", ECCV workshops, 2016.

An object keeps the track that it was matched with last, as long as that is near enough; only then the others are
assigned, as many as possible, at the smallest sum of distances.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.evaluation.assignment import dense_assignment, far_cost, is_alone
from lidcam.pipeline.evaluation.tracking.table import TrackTable


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Matches of true objects with boxes."""

    pairs: I64  # (K,) int64, rows of the table's pairs, ordered by true track, then by frame
    is_switch: Bools  # (K,) bool, whether the object's match before this one had another track


@dataclass(frozen=True, slots=True)
class ClearCounts:
    """Sums over all frames."""

    truth: int
    found: int
    matches: int
    switches: int
    distance_m: float
    fragmentations: int


def match_clear(table: TrackTable) -> Matches:
    """Match the objects of each frame with the boxes found, in the order of time."""
    pairs = np.flatnonzero(table.pairs.distances_m < table.max_distance_m)
    first, second = table.pairs.truth[pairs], table.pairs.found[pairs]
    chosen = _chosen(table, first, second, table.pairs.distances_m[pairs])
    pairs, first = pairs[chosen], first[chosen]
    order = np.lexsort((table.truth.frames[first], table.truth.tracks[first]))
    truth_tracks, found_tracks = table.truth.tracks[first[order]], table.found.tracks[second[chosen][order]]
    is_switch = np.zeros(len(order), np.bool_)
    is_switch[1:] = (np.diff(truth_tracks) == 0) & (np.diff(found_tracks) != 0)
    return Matches(pairs[order], is_switch)


def _chosen(table: TrackTable, first: I64, second: I64, distances_m: F64) -> Bools:
    """The pairs that are chosen, frame by frame: first those that go on, then the nearest."""
    chosen, frames, alone = np.zeros(len(first), np.bool_), table.truth.frames[first], is_alone(first, second)
    names = [*zip(table.truth.tracks[first].tolist(), table.found.tracks[second].tolist(), strict=True)]
    last: dict[int, int] = {}
    order = np.argsort(frames, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(frames[order])) + 1) if len(order) else ():
        kept: dict[int, int] = {}  # pairs that go on, by the row of the box
        for row in rows.tolist():
            if last.get(names[row][0]) == names[row][1]:
                kept.setdefault(int(second[row]), row)
        chosen[[*kept.values()]] = True
        rest = rows[~np.isin(first[rows], first[[*kept.values()]]) & ~np.isin(second[rows], [*kept])]
        if not alone[rest].all():
            costs = distances_m[rest]
            rest = rest[dense_assignment(first[rest], second[rest], costs, far_cost(costs))]
        chosen[rest] = True
        last.update(names[row] for row in rows[chosen[rows]].tolist())
    return chosen


def count_clear(table: TrackTable, matches: Matches) -> ClearCounts:
    """The counts of one class."""
    rows = table.pairs.truth[matches.pairs]
    order = np.lexsort((table.truth.frames, table.truth.tracks))
    is_matched = np.zeros(len(order), np.bool_)
    is_matched[rows] = True
    is_matched, tracks = is_matched[order], table.truth.tracks[order]
    tracked = np.bincount(tracks, is_matched, table.truth.track_count)
    # Every loss counts but the last of a track that is not found again.
    losses = int((is_matched[:-1] & ~is_matched[1:] & (np.diff(tracks) == 0)).sum())
    ends = np.flatnonzero(np.diff(tracks, append=-1))
    lost_for_good = int(((tracked > 0) & ~is_matched[ends]).sum())
    return ClearCounts(
        truth=len(order),
        found=len(table.found),
        matches=len(rows),
        switches=int(matches.is_switch.sum()),
        distance_m=float(table.pairs.distances_m[matches.pairs].sum()),
        fragmentations=losses - lost_for_good,
    )


def clear_figures(counts: ClearCounts) -> dict[str, float | int | None]:
    """MOTA and what it is made of; None where there is nothing to measure."""
    misses, false_positives = counts.truth - counts.matches, counts.found - counts.matches
    errors = misses + false_positives + counts.switches
    return {
        "mota": 1 - errors / counts.truth if counts.truth else None,
        "motp_m": counts.distance_m / counts.matches if counts.matches else None,
        "recall": counts.matches / counts.truth if counts.truth else None,
        "precision": counts.matches / counts.found if counts.found else None,
        "false_positives": false_positives,
        "misses": misses,
        "id_switches": counts.switches,
        "fragmentations": counts.fragmentations,
    }


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
