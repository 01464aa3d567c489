"""Fit anew how the method `combined` weighs a 3D network and the learned score of clusters, in worlds held out.

    python benchmarks/measured/combined_fit.py [--worlds 70] [--model FILE.onnx]

Prints `FITTED` of pipeline/detectors/combined.py for its kinds car, pedestrian, cyclist and large vehicle: the
coefficients of a logistic regression on drawn roads and crossings that no training has seen. A box is right if an
object of its kind is near, as for the learned score. Right people, cyclists and large vehicles count as often as in
streets, less than in drawn worlds. Where the network has no box, only boxes in its grid are fitted to.

`FITTED` is of 280 sweeps of 70 worlds; the number of points and the distance added nothing, except to large vehicles
beside a lidar on a road: `detect3d.near_weight` is of 880 such sweeps, with the other coefficients as they are; at
crossings it would be -0.15. In real frames most people and cyclists of a network in pillars are posts and the like, and
it misses more of them. So half of the fit counts for cyclists (all of it: 0.25, 0.29, 1.17 and -1.95, 1.03); and
clusters of people keep their score, and boxes of people have no higher one (the fit where the network has none: -0.20,
1.05).

All this is of the learned score of 200 roads. A fit with one of 600 roads and 600 crossings, which knows drawn worlds
better (cars: 0.18, 0.44, 0.49 and -2.04, 0.76), lost 2 of 15 cars of a real sweep and was not taken.
"""

import argparse

import numpy as np
from held_out_worlds import FIRST_WORLD, combined_cloud
from scipy.optimize import minimize

from lidcam.bags.simulator.worlds.draw import Family
from lidcam.bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD, sweep
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.cluster.kinds import KINDS, kinds_of
from lidcam.pipeline.detectors.combined import CombinedDetector
from lidcam.training.card import PRIORS
from lidcam.training.examples import KIND_OF_CLASS, MIN_POINTS, SWEEPS_OF_A_WORLD, kinds_of_boxes

WORLDS_BEFORE = 100_000  # from so many worlds before those that judge

PULL = 1e-3


def main() -> None:
    """Look at all worlds, fit, and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--worlds", type=int, default=70)
    parser.add_argument("--model", default="traffic")
    given = parser.parse_args()
    families: list[Family] = ["road", "crossing"]
    worlds = [(family, row) for row in range(given.worlds // 2) for family in families]
    table = np.concatenate([_rows(given.model, family, row) for family, row in worlds])
    kind, is_right, learned, network, near, reached = table.T
    has_box = ~np.isnan(network)
    for row, name in enumerate(KINDS[1:], 1):
        of_kind = kind == row
        both, alone = of_kind & has_box, of_kind & ~has_box & (reached > 0)
        for rows, columns in ((both, [learned, network, near]), (alone, [learned])):
            features = np.column_stack([np.ones(rows.sum()), *(one[rows] for one in columns)])
            fitted = _regression(features, is_right[rows], PRIORS[row])
            print(
                f"{name:14} {len(columns)}: {rows.sum():6} boxes, {is_right[rows].sum():5.0f} right, {fitted.round(2)}"
            )


def _rows(model: str, family: Family, world: int) -> F64:
    """(N, 6) kind, whether it is right, log odds by the learned score and the network, `near`, and `is_reached`."""
    config = load_config(family, (f"detect3d.model={model}",))
    first, step = (FIRST_WORLD - WORLDS_BEFORE + world) * SWEEPS_PER_WORLD, SWEEPS_PER_WORLD // SWEEPS_OF_A_WORLD
    answer = []
    for seed in range(first, first + SWEEPS_PER_WORLD, step):
        taken = sweep(family, seed)
        rig, combined = combined_cloud(taken, config)
        detector = CombinedDetector(rig, config)
        boxes, learned, network, is_reached, nearness = detector.evidence(combined)
        kind = kinds_of(config.classes).argmax(1)[boxes.class_ids]
        is_seen = taken.point_counts >= MIN_POINTS
        true_kinds = np.array([KIND_OF_CLASS[name] for name in taken.class_names], np.int64)[is_seen]
        is_right = np.zeros(len(boxes))
        for one in range(1, len(KINDS)):
            true_xy = taken.centers[is_seen][true_kinds == one, :2]
            near = kinds_of_boxes(boxes.centers[:, :2], true_xy, np.full(len(true_xy), one))
            is_right[(kind == one) & (near == one)] = 1
        answer.append(np.column_stack([kind, is_right, learned, network, nearness, is_reached]))
    return np.concatenate(answer)


def _regression(features: F64, is_right: F64, weight_of_right: float) -> F64:
    """(K,) coefficients of features (N, K)."""
    sign, weights = 1 - 2 * is_right, np.where(is_right > 0, weight_of_right, 1.0)

    def loss(coefficients: F64) -> float:
        return float(np.average(np.logaddexp(0, sign * (features @ coefficients)), weights=weights)) + PULL * float(
            (coefficients**2).sum()
        )

    return np.asarray(minimize(loss, np.zeros(features.shape[1])).x)


if __name__ == "__main__":
    main()
