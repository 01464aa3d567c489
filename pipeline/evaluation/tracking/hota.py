"""Higher order tracking accuracy (Luiten et al., "HOTA", IJCV 129, 2021)."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.evaluation.assignment import assign_heaviest
from lidcam.pipeline.evaluation.tracking.table import TrackTable

ALPHAS = np.arange(1, 20) / 20
"""Similarities from which a pair is a match: 0.05 to 0.95."""

TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class HotaCounts:
    """Matches at each of the thresholds `ALPHAS`, and sums over these matches."""

    truth: int  # True objects in all frames
    found: int  # Boxes found in all frames
    matches: F64  # (A,) float64
    similarity: F64  # (A,) float64, sum over the matches
    association: F64  # (A,) float64, likewise, of the share that the two tracks of a match have in common
    association_recall: F64  # (A,) float64, of the share of the true track
    association_precision: F64  # (A,) float64, of the share of the track found


def count_hota(table: TrackTable) -> HotaCounts:
    """The counts of one class.

    The similarity of a pair is 1 where the centres are the same, and 0 from the largest distance of a match on. The
    pairs of a frame are chosen once, for all thresholds: the assignment with the largest sum of the similarity of the
    boxes times that of their tracks.
    """
    similarity = np.maximum(0.0, 1 - table.pairs.distances_m / table.max_distance_m)
    near = np.flatnonzero(similarity > 0)
    first, second, similarity = table.pairs.truth[near], table.pairs.found[near], similarity[near]
    lengths = np.bincount(table.truth.tracks), np.bincount(table.found.tracks)
    width = max(1, table.found.track_count)
    keys, pair_of = np.unique(table.truth.tracks[first] * width + table.found.tracks[second], return_inverse=True)
    together = lengths[0][keys // width] + lengths[1][keys % width]
    rivals = np.bincount(first, similarity)[first] + np.bincount(second, similarity)[second] - similarity
    alike = np.bincount(pair_of, similarity / rivals, len(keys))
    chosen = assign_heaviest(first, second, (alike / (together - alike))[pair_of] * similarity)
    first, second, similarity, pair_of = first[chosen], second[chosen], similarity[chosen], pair_of[chosen]
    sums = np.zeros((5, len(ALPHAS)))
    for column, alpha in enumerate(ALPHAS):
        matched = similarity >= alpha - TOLERANCE
        count = np.bincount(pair_of[matched], minlength=len(keys)).astype(np.float64)
        sums[:, column] = [
            count.sum(),
            similarity[matched].sum(),
            (count * count / np.maximum(1, together - count)).sum(),
            (count[pair_of] / lengths[0][table.truth.tracks[first]])[matched].sum(),
            (count[pair_of] / lengths[1][table.found.tracks[second]])[matched].sum(),
        ]
    return HotaCounts(len(table.truth), len(table.found), *sums)


def hota_figures(counts: HotaCounts) -> dict[str, float | None]:
    """HOTA and its parts, means over the thresholds; None where there is nothing to measure.

    As in TrackEval, a threshold that no pair reaches counts with an association of 0, and with a localisation of 1 (its
    absence is seen in the detection); where no threshold is reached there is no localisation.
    """
    matches, truth, found = counts.matches, counts.truth, counts.found
    some = np.maximum(1, matches)
    det_a = matches / np.maximum(1, truth + found - matches)
    ass_a = counts.association / some
    anything = truth + found > 0
    return {
        "hota": _mean(np.sqrt(det_a * ass_a), anything),
        "det_a": _mean(det_a, anything),
        "ass_a": _mean(ass_a, anything),
        "loc_a": _mean(np.where(matches > 0, counts.similarity / some, 1.0), bool(matches.any())),
        "det_re": _mean(matches / max(1, truth), truth > 0),
        "det_pr": _mean(matches / max(1, found), found > 0),
        "ass_re": _mean(counts.association_recall / some, anything),
        "ass_pr": _mean(counts.association_precision / some, anything),
    }


def _mean(values: F64, is_defined: bool) -> float | None:
    return float(values.mean()) if is_defined else None
