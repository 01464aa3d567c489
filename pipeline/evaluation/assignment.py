"""Assignment of results to truth in all frames at once.

Pairs (P,) are given as `first` and `second`, the row on either side. Rows of different frames never share a pair, so
the pairs of a recording fall into many small components. Most are a single pair; the others are solved one by one.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices


def is_alone(first: I64, second: I64) -> Bools:
    """Whether neither row of each pair (P,) is part of another pair."""
    return np.asarray((np.bincount(first)[first] == 1) & (np.bincount(second)[second] == 1))


def conflicts(first: I64, second: I64) -> Iterator[Indices]:
    """Rows of the pairs of each component, rising, in the order of the component's first pair."""
    if not len(first):
        return
    from scipy.sparse import coo_array  # a fifth of a second: behind the imports of the programs
    from scipy.sparse.csgraph import connected_components

    rows, first_nodes = np.unique(first, return_inverse=True)
    columns, second_nodes = np.unique(second, return_inverse=True)
    count = len(rows) + len(columns)
    edges = (np.ones(len(first), np.int8), (first_nodes, second_nodes + len(rows)))
    _, labels = connected_components(coo_array(edges, shape=(count, count)), directed=False)
    _, earliest, component = np.unique(labels[first_nodes], return_index=True, return_inverse=True)
    order = np.lexsort((np.arange(len(first)), earliest[component]))
    starts = np.flatnonzero(np.diff(earliest[component][order])) + 1
    for start, end in pairwise([0, *starts.tolist(), len(first)]):
        yield order[start:end]


def dense_assignment(first: I64, second: I64, costs: F64, missing: float) -> Bools:
    """(P,) the pairs of one component in the assignment of least cost; two rows that are no pair cost `missing`."""
    from scipy.optimize import linear_sum_assignment  # a third of a second: behind the imports of the programs

    # Most components have two or three pairs: sets are faster than sorted arrays there.
    first_rows, second_rows = first.tolist(), second.tolist()
    rows = {row: k for k, row in enumerate(sorted(set(first_rows)))}
    columns = {row: k for k, row in enumerate(sorted(set(second_rows)))}
    row_of, column_of = [rows[row] for row in first_rows], [columns[row] for row in second_rows]
    matrix = np.full((len(rows), len(columns)), missing)
    matrix[row_of, column_of] = costs
    chosen = np.zeros(matrix.shape, np.bool_)
    chosen[linear_sum_assignment(matrix)] = True
    return np.asarray(chosen[row_of, column_of])


def assign_nearest(first: I64, second: I64, distances: F64) -> Bools:
    """(P,) the chosen pairs: as many as possible, each row once, at the smallest sum of distances (P,) >= 0."""
    return _assign(first, second, distances, far_cost(distances))


def assign_heaviest(first: I64, second: I64, weights: F64) -> Bools:
    """(P,) the chosen pairs: each row once at most, with the largest sum of weights (P,) > 0."""
    return _assign(first, second, -weights, 0.0)


def far_cost(distances: F64) -> float:
    """A cost that outweighs all distances of one component, so that more pairs are better than nearer ones."""
    return 1e4 * float(distances.max(initial=0.0)) + 1.0


def _assign(first: I64, second: I64, costs: F64, missing: float) -> Bools:
    chosen = is_alone(first, second)
    open_pairs = np.flatnonzero(~chosen)
    for component in conflicts(first[open_pairs], second[open_pairs]):
        pairs = open_pairs[component]
        chosen[pairs] = dense_assignment(first[pairs], second[pairs], costs[pairs], missing)
    return chosen
