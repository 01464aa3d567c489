import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pipeline.fusion.matching.pairing import Pairs, best_pairs, near_pairs

from pipeline.core.arrays import F64


def all_pairs(worth: F64) -> Pairs:
    seen, found = (np.asarray(rows, np.int64) for rows in np.indices(worth.shape).reshape(2, -1))
    return Pairs(seen, found, np.zeros(worth.size))


def test_near_pairs_are_of_one_image() -> None:
    box = np.array([[0, 0, 10, 10]], np.float32)
    seen, found = np.repeat(box, 3, 0), np.concatenate([box, box + 15, box])
    cameras = np.array([0, 0, 2], np.int64)
    pairs = near_pairs(seen, cameras, found, np.array([0, 0, 1], np.int64), min_giou=-0.3)
    assert list(zip(pairs.seen, pairs.found, pairs.iou, strict=True)) == [(0, 0, 1.0), (1, 0, 1.0)]
    farther = near_pairs(seen, cameras, found, np.array([0, 0, 1], np.int64), min_giou=-1)
    assert farther.iou.tolist() == [1, 0, 1, 0]


@given(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(1, 2)).flatmap(
        lambda shape: arrays(np.float64, shape, elements=st.sampled_from([-3.0, 0.0, 0.5, 1.0, 1.25, 2.0, 4.0]))
    )
)
def test_sum_is_the_best_there_is(worths: F64) -> None:
    """Two cameras with the same numbers of boxes: worth (3D, 2D, camera)."""
    height, width, cameras = worths.shape
    parts = [all_pairs(worths[..., k]) for k in range(cameras)]
    pairs = Pairs(
        np.concatenate([part.seen + k * height for k, part in enumerate(parts)]),
        np.concatenate([part.found + k * width for k, part in enumerate(parts)]),
        np.concatenate([part.iou for part in parts]),
    )
    flat = np.moveaxis(worths, -1, 0).reshape(-1)
    taken = best_pairs(pairs, flat, np.repeat(np.arange(cameras), height))
    best = 0.0
    for k in range(cameras):
        table = np.maximum(worths[..., k], 0)
        table = table if height <= width else table.T
        best += max(
            sum(table[i, j] for i, j in enumerate(columns))
            for columns in itertools.permutations(range(max(height, width)), min(height, width))
        )
    assert flat[taken].sum() == best
    assert (flat[taken] > 0).all()
    for rows in (pairs.seen[taken], pairs.found[taken]):
        assert len(set(rows.tolist())) == len(rows)
