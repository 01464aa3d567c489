"""CLEAR MOT, and how much of the truth is found under one name.

Bernardin and Stiefelhagen, "Evaluating multiple object tracking performance", EURASIP JIVP, 2008; identity measures:
Ristani et al., "Performance measures and a data set for multi-target, multi-camera tracking", ECCV workshops, 2016.

An object keeps the track that it was matched with last, as long as that is near enough; only then the others are
assigned, as many as possible, at the smallest sum of distances. Mostly tracked and mostly lost: Wu and Nevatia,
"Tracking of multiple, partially occluded humans based on static body part detection", CVPR 2006.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.evaluation.assignment import conflicts, dense_assignment, far_cost, is_alone
from lidcam.pipeline.evaluation.tracking.table import TrackTable

MOSTLY_TRACKED = 0.8
"""Smallest share of its frames in which a mostly tracked object is matched."""

MOSTLY_LOST = 0.2
"""Share of its frames below which an object is mostly lost."""

NEVER = (-1, -1)
"""Frame and track of an object that was never matched."""


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Matches of true objects with boxes.

    Attributes:
        pairs: (K,) int64, rows of the table's pairs, ordered by true track, then by frame.
        is_switch: (K,) bool, whether the object's match before this one had another track.
    """

    pairs: I64
    is_switch: Bools


@dataclass(frozen=True, slots=True)
class ClearCounts:
    """Sums over all frames, and over all true tracks."""

    truth: int
    found: int
    matches: int
    switches: int
    distance_m: float
    fragmentations: int
    mostly_tracked: int
    partly_tracked: int
    mostly_lost: int


def match_clear(table: TrackTable) -> Matches:
    """Match the objects of each frame with the boxes found, in the order of time."""
    pairs = np.flatnonzero(table.pairs.distances_m < table.max_distance_m)
    first, second = table.pairs.truth[pairs], table.pairs.found[pairs]
    chosen = is_alone(first, second)
    if not chosen.all():
        chosen |= _decided(table, first, second, table.pairs.distances_m[pairs], chosen)
    pairs, first = pairs[chosen], first[chosen]
    order = np.lexsort((table.truth.frames[first], table.truth.tracks[first]))
    truth_tracks, found_tracks = table.truth.tracks[first[order]], table.found.tracks[second[chosen][order]]
    is_switch = np.zeros(len(order), np.bool_)
    is_switch[1:] = (np.diff(truth_tracks) == 0) & (np.diff(found_tracks) != 0)
    return Matches(pairs[order], is_switch)


def _decided(table: TrackTable, first: I64, second: I64, distances_m: F64, sure: Bools) -> Bools:
    """The pairs that are chosen where a row is part of several; `sure` are the pairs that need no decision."""
    before = _last_sure_matches(table, first[sure], second[sure])
    decided: dict[int, tuple[int, int]] = {}
    chosen = np.zeros(len(first), np.bool_)
    truth_rows, found_rows = first.tolist(), second.tolist()
    truth_tracks, found_tracks = table.truth.tracks[first].tolist(), table.found.tracks[second].tolist()
    frames = table.truth.frames[first].tolist()
    rows = np.flatnonzero(~sure)
    for component in conflicts(first[rows], second[rows]):
        pairs = rows[component].tolist()
        done: set[int] = set()
        taken: set[int] = set()
        kept = []
        for pair in pairs:
            truth, found = truth_rows[pair], found_rows[pair]
            last = max(decided.get(truth_tracks[pair], NEVER), before[truth])
            if last[1] == found_tracks[pair] and truth not in done and found not in taken:
                done.add(truth)
                taken.add(found)
                kept.append(pair)
        rest = [pair for pair in pairs if truth_rows[pair] not in done and found_rows[pair] not in taken]
        if len(rest) > 1:
            costs = distances_m[rest]
            is_best = dense_assignment(first[rest], second[rest], costs, far_cost(costs))
            rest = [pair for pair, best in zip(rest, is_best.tolist(), strict=True) if best]
        chosen[kept + rest] = True
        decided |= {truth_tracks[pair]: (frames[pair], found_tracks[pair]) for pair in kept + rest}
    return chosen


def _last_sure_matches(table: TrackTable, first: I64, second: I64) -> list[tuple[int, int]]:
    """For each true object the frame and track of the last match of its track that needed no decision, or `NEVER`."""
    matched = np.full(len(table.truth), -1, np.int64)
    matched[first] = table.found.tracks[second]
    order = np.lexsort((table.truth.frames, table.truth.tracks))
    places = np.arange(len(order))
    starts = np.searchsorted(table.truth.tracks[order], table.truth.tracks[order], "left")
    last = np.maximum.accumulate(np.where(matched[order] >= 0, places, -1))
    known = last >= starts
    frames, tracks = np.full(len(order), -1, np.int64), np.full(len(order), -1, np.int64)
    frames[order[known]] = table.truth.frames[order[last[known]]]
    tracks[order[known]] = matched[order[last[known]]]
    return list(zip(frames.tolist(), tracks.tolist(), strict=True))


def count_clear(table: TrackTable, matches: Matches) -> ClearCounts:
    """The counts of one class."""
    rows = table.pairs.truth[matches.pairs]
    order = np.lexsort((table.truth.frames, table.truth.tracks))
    is_matched = np.zeros(len(order), np.bool_)
    is_matched[rows] = True
    is_matched, tracks = is_matched[order], table.truth.tracks[order]
    count = table.truth.track_count
    lengths, tracked = np.bincount(tracks, minlength=count), np.bincount(tracks, is_matched, count)
    share = tracked / lengths
    # Every loss counts but the last of a track that is not found again.
    losses = int((is_matched[:-1] & ~is_matched[1:] & (np.diff(tracks) == 0)).sum())
    ends = np.flatnonzero(np.diff(tracks, append=-1))
    lost_for_good = int(((tracked > 0) & ~is_matched[ends]).sum())
    mostly_tracked, mostly_lost = int((share >= MOSTLY_TRACKED).sum()), int((share < MOSTLY_LOST).sum())
    return ClearCounts(
        truth=len(order),
        found=len(table.found),
        matches=len(rows),
        switches=int(matches.is_switch.sum()),
        distance_m=float(table.pairs.distances_m[matches.pairs].sum()),
        fragmentations=losses - lost_for_good,
        mostly_tracked=mostly_tracked,
        partly_tracked=count - mostly_tracked - mostly_lost,
        mostly_lost=mostly_lost,
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
        "mostly_tracked": counts.mostly_tracked,
        "partly_tracked": counts.partly_tracked,
        "mostly_lost": counts.mostly_lost,
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
