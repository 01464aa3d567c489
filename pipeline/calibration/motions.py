"""Small motions, and covariances of fits to measurements with common errors in groups."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.geometry.rotations import pose_matrix, turned


def motion(values: F64) -> F64:
    """(4, 4) the motion by a rotation vector (radians) and a translation (metres), the first six of `values`."""
    return pose_matrix(turned(values[:3]), values[3:6])


def jackknife_covariance(scores: F64, information: F64, groups: I64, normal: F64, prior: F64) -> F64:
    """(D, D) covariance of a weighted least-squares fit whose residuals are correlated within a few groups.

    The spread of the fits that lack one group, by one Gauss-Newton step (Bell and McCaffrey, Bias reduction in standard
    errors for linear regression with multi-stage samples, Survey Methodology 28(2), 2002). The plain
    spread of the groups is too small where a fit follows the common errors of few.

    Args:
        scores: (N, D) weighted derivatives times residuals.
        information: (N, D, D) weighted outer products of the derivatives.
        groups: (N, K) group of each measurement, by equal rows.
        normal: (D, D) normal matrix, prior included.
        prior: (D,) diagonal information of the prior.
    """
    _, group = np.unique(groups, axis=0, return_inverse=True)
    count = int(group.max()) + 1
    sums, lacking = np.zeros((count, len(prior))), np.tile(normal, (count, 1, 1))
    np.add.at(sums, group.ravel(), scores)
    np.subtract.at(lacking, group.ravel(), information)
    steps = np.linalg.solve(lacking, sums[..., None])[..., 0]
    inverse = np.linalg.inv(normal)
    return np.asarray(steps.T @ steps * ((count - 1) / count) + inverse @ np.diag(prior) @ inverse)
