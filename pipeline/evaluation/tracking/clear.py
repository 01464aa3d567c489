"""CLEAR MOT, and how much of the truth is found under one name.

Bernardin and Stiefelhagen, "Evaluating multiple object tracking performance", EURASIP JIVP, 2008; identity measures:
Ristani et al., "Performance measures and a data set for multi-target, multi-camera tracking", ECCV workshops, 2016.

An object keeps the track that it was matched with last, as long as that is near enough; only then the others are
assigned, as many as possible, at the smallest sum of distances.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices
from lidcam.pipeline.evaluation.assignment import dense_assignment, far_cost, is_alone
from lidcam.pipeline.evaluation.detection.curves import ratio
from lidcam.pipeline.evaluation.tracking.table import TrackTable


@dataclass(frozen=True, slots=True)
class ClearCounts:
    """Sums over all frames."""

    truth: int  # True objects
    found: int  # Boxes found
    matches: int
    switches: int  # Matches of an object whose match before had another track
    distance_m: float  # Of the matches
    fragmentations: int
    identity_matches: int  # Boxes near their object, if each true track has at most one track found for all of its time


def match_clear(table: TrackTable) -> Indices:
    """(K,) pairs of the table in which objects and boxes match, in each frame, by true track, then by frame."""
    pairs = np.flatnonzero(table.pairs.distances_m < table.max_distance_m)
    first, second = table.pairs.truth[pairs], table.pairs.found[pairs]
    chosen = _chosen(table, first, second, table.pairs.distances_m[pairs])
    pairs, first = pairs[chosen], first[chosen]
    return pairs[np.lexsort((table.truth.frames[first], table.truth.tracks[first]))]


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


def count_clear(table: TrackTable, matches: Indices) -> ClearCounts:
    """The counts of one class; `matches` as of `match_clear`."""
    rows, boxes = table.pairs.truth[matches], table.pairs.found[matches]
    is_switch = (np.diff(table.truth.tracks[rows]) == 0) & (np.diff(table.found.tracks[boxes]) != 0)
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
        switches=int(is_switch.sum()),
        distance_m=float(table.pairs.distances_m[matches].sum()),
        fragmentations=losses - lost_for_good,
        identity_matches=_identity_matches(table),
    )


def clear_figures(counts: ClearCounts) -> dict[str, float | int | None]:
    """MOTA and IDF1, and what they are made of; None where there is nothing to measure."""
    truth, found, same = counts.truth, counts.found, counts.identity_matches
    misses, false_positives = truth - counts.matches, found - counts.matches
    errors = misses + false_positives + counts.switches
    return {
        "mota": 1 - errors / truth if truth else None,
        "motp_m": ratio(counts.distance_m, counts.matches),
        "recall": ratio(counts.matches, truth),
        "precision": ratio(counts.matches, found),
        "false_positives": false_positives,
        "misses": misses,
        "id_switches": counts.switches,
        "fragmentations": counts.fragmentations,
        "idf1": ratio(2 * same, truth + found),
        "idp": ratio(same, found),
        "idr": ratio(same, truth),
    }


def _identity_matches(table: TrackTable) -> int:
    """Boxes near their object, of the pairs of tracks that have the most of them."""
    near = table.pairs.distances_m < table.max_distance_m
    tracks = table.truth.tracks[table.pairs.truth[near]], table.found.tracks[table.pairs.found[near]]
    pairs, counts = np.unique(np.stack(tracks, 1), axis=0, return_counts=True)
    return _most(pairs, counts)


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
