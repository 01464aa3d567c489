"""Boxes fitted to the edges of 2D boxes: a small robust least-squares problem for each, all of them at once.

The unknowns are x, y, yaw and size of a box, which keeps its underside, and its speed where the images were taken at
another time than the cloud. The prior is the box with its covariance; the residuals are the differences between the
edges of its 2D boxes and those of its projection. At a fixed yaw the edges are almost linear in the other unknowns, but
not in the yaw: when another corner becomes the outermost, the slope changes its sign, and there may be several minima.
So some yaws around the prior are tried, the other unknowns are solved for each by Gauss-Newton steps, and the solutions
are averaged by their probabilities (Laplace's approximation of the integral). This is done twice, the second time
around the first average. The mean of the distribution errs less than its mode, and its covariance shows when two
headings fit alike.

Residuals have Cauchy weights (iteratively reweighted), so that a wrong 2D box does little harm.

A rider of whom the lidars see little more than the shoulders may face along the points or across them. A box of unknown
heading is fitted again from the heading at right angles, and the likelier fit is taken.
"""

from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, first_of_runs
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import rotations_2d, wrap_angle
from lidcam.pipeline.detectors.log_odds import softmax
from lidcam.pipeline.fusion.projection import Outline, project_edges
from lidcam.pipeline.fusion.refining.box_prior import MAX_YAW_SIGMA_RAD, MIN_ELONGATION, BoxPrior
from lidcam.pipeline.fusion.refining.edges import MeasuredEdges

YAW_SIGMAS = np.linspace(-2.5, 2.5, 5)
"""Headings that are tried, in standard deviations from the mean."""

CAUCHY_SCALE = 3.0
"""Residual with half the weight, in standard deviations."""

MIN_WEIGHT = 1e-60
"""Minimum weight of an edge: near the plane of a camera, derivatives are large, and 1e-6 of them would decide."""

MAX_SQUARED_RESIDUAL = 1e30
"""Maximum squared residual, in units of `CAUCHY_SCALE`: beyond, likelihoods vanish."""

BORDER_SIGMAS = 3.0
"""Distance of an edge from the border of the image within which it may be the border, in standard deviations."""

MAX_SQUARED_STEP = 16.27
"""Maximum squared step in standard deviations of the prior: 99.9 % for three degrees of freedom."""

MIN_SIZE, MAX_SIZE = 0.5, 1.5
"""Bounds of refined sizes, as shares of the prior's."""

EIGHTH_TURN_SIGMA_RAD = np.pi / 2 / np.sqrt(12.0)
"""Standard deviation of a heading that is within an eighth of a turn, radians."""

TURNED_SHARE = 0.3
"""Share of boxes of unknown heading that are turned by more than an eighth: 32 of 111 cyclists in three simulated
recordings."""

TURNED_COST = 2 * np.log(1 / TURNED_SHARE - 1)
"""Cost of a turned box, as twice a negative log likelihood."""

_YAW = 2
_REST = np.array([0, 1, 3, 4, 5, 6, 7])
"""Rows of `box_prior.STATES` that are solved at a fixed yaw."""


class RefinedBoxes(NamedTuple):
    """N boxes after refinement."""

    centers_xy: F64  # (N, 2) float64 metres
    yaws: F64  # (N,) float64 radians
    sizes: F64  # (N, 3) float64 metres; the undersides stay
    covariances: F64  # (N, 3, 3) float64 over x, y and yaw
    later_s: F64  # (N,) float64 time of the refined box after that of the prior, seconds
    # (N,) whether the result explains the images better than the prior, and is not too far from it; else the row is
    # that of the prior
    accepted: Bools
    costs: F64  # (N,) float64 twice the negative log probability of the images and the fit


class _Problem(NamedTuple):
    """N boxes, and P pairs with an outline of the box for each."""

    boxes: Boxes3D  # Boxes of the prior
    prior: BoxPrior  # Its distributions
    edges: MeasuredEdges  # Sorted by the box; each box has some
    outline: Outline  # Outline of the box of each pair
    turn: F64  # (N, 2, 2) from the axes of the boxes to those of the site
    turn_of_pair: F64  # (P, 2, 2) the same for the box of each pair
    starts: Indices  # (N,) first pair of each box
    near: Bools  # (P, 1, 4) whether each edge may be the border of the image
    known: F64  # (N, 1, 7, 7) information of the prior over all states but the yaw

    @classmethod
    def of(cls, boxes: Boxes3D, prior: BoxPrior, edges: MeasuredEdges, outline: Outline) -> Self:
        """The problem, with the terms that are the same in all steps."""
        turn, starts = rotations_2d(boxes.yaws), np.flatnonzero(first_of_runs(edges.rows))
        near = np.minimum(edges.xyxy, edges.cameras.limits - edges.xyxy) < BORDER_SIGMAS * edges.sigma_px
        known = prior.information[:, None, _REST[:, None], _REST]
        return cls(boxes, prior, edges, outline, turn, turn[edges.rows], starts, near[:, None], known)

    def projected(self, states: F64) -> tuple[F64, F64]:
        """The edges of the boxes in some states, at the times of the images.

        Args:
            states: (N, K, 8) in the order of `STATES`, less the prior's.

        Returns:
            (P, K, 4) edges, pixels, and (P, K, 4, 6) their derivatives by the states but the speed.
        """
        boxes, edges, rows = self.boxes, self.edges, self.edges.rows
        at_pairs, pairs = states[rows], np.arange(len(rows)).repeat(states.shape[1])
        moved = at_pairs[..., 6:] @ self.turn_of_pair.swapaxes(1, 2) * edges.later_s[:, None, None]
        centers, sizes, yaws = (values.take(rows[pairs], 0) for values in (boxes.centers, boxes.sizes, boxes.yaws))
        centers[:, :2] += (at_pairs[..., :2] + moved).reshape(len(pairs), 2)
        before, sizes = sizes, _resized(sizes, at_pairs[..., 3:6].reshape(len(pairs), 3))
        centers[:, 2] += (sizes[:, 2] - before[:, 2]) / 2
        yaws += at_pairs[..., _YAW].reshape(len(pairs))
        found = project_edges(centers, sizes, yaws, edges.cameras, self.outline, rows=pairs)
        jacobian = found.jacobian.reshape(*moved.shape[:2], 4, 7)
        jacobian[..., 5] += jacobian[..., 6] / 2  # the underside stays
        return found.xyxy.reshape(*moved.shape[:2], 4), jacobian[..., :6]

    def linearised(self, states: F64) -> tuple[F64, F64, F64]:
        """The linear systems of a Gauss-Newton step at a fixed yaw, from each of the states.

        An edge of a 2D box near the border of its image may be the border, so it is compared with the projected edge
        clipped to the image, whose derivatives are zero there.

        Args:
            states: (N, K, 8) less the prior's.

        Returns:
            (N, K, 7, 7) normal matrices over all states but the yaw; (N, K, 7) their right sides; (N, K) twice the
            negative log probability.
        """
        xyxy, jacobian = self.projected(states)
        edges = self.edges
        limits, sigma_px = edges.cameras.limits[:, None], edges.sigma_px[:, None]
        clipped = np.where(self.near, np.minimum(np.maximum(xyxy, 0.0), limits), xyxy)
        is_free = clipped == xyxy
        residual = edges.xyxy[:, None] - clipped
        by_speed = jacobian[..., :2] @ self.turn_of_pair[:, None] * edges.later_s[:, None, None, None]
        slopes = np.concatenate([jacobian[..., [0, 1, 3, 4, 5]], by_speed], 3)
        # What the edges share by the weights of whole residuals, then the weights of the rest.
        shared, _ = self._shared(is_free * self._weights(residual / sigma_px)[0], residual)
        weights, costs = self._weights((residual - shared) / sigma_px)
        weights = is_free * weights
        _, shared_cost = self._shared(weights, residual)
        weighted = self._over_variances(weights, slopes)
        prior_pull = states @ self.prior.information
        normal = np.add.reduceat(weighted.swapaxes(2, 3) @ slopes, self.starts) + self.known
        right = (weighted * residual[..., None]).sum(2)
        right = np.add.reduceat(right, self.starts) - prior_pull[..., _REST]
        cost = np.add.reduceat(costs.sum(2) + shared_cost, self.starts) + (prior_pull * states).sum(2)
        return normal, right, cost

    def _over_variances(self, weights: F64, values: F64) -> F64:
        """Values (P, K, 4, ...) of the edges times the inverse of their covariances: own noise, and what they share."""
        own = self.edges.sigma_px[:, None] ** 2 / np.maximum(weights, MIN_WEIGHT)
        same, across = self.edges.shared_px2
        first, second = own[..., :2] + same, own[..., 2:] + same
        determinant = first * second - across**2
        more = (1,) * (values.ndim - 3)
        own_first, own_second, both = (
            part.reshape(*part.shape, *more)
            for part in (second / determinant, first / determinant, -across / determinant)
        )
        low, high = values[:, :, :2], values[:, :, 2:]
        return np.concatenate([own_first * low + both * high, both * low + own_second * high], 2)

    def _shared(self, weights: F64, residual: F64) -> tuple[F64, F64]:
        """(P, K, 4) the likeliest shared part of residuals in pixels, and (P, K) its squared size in deviations."""
        same, across = self.edges.shared_px2
        over = self._over_variances(weights, residual)
        low, high = over[..., :2], over[..., 2:]
        shared = np.concatenate([same * low + across * high, across * low + same * high], 2)
        return shared, (over * shared).sum(2)

    def _weights(self, residual: F64) -> tuple[F64, F64]:
        """Weights of the edges with residuals (P, K, 4), and twice their negative log likelihoods."""
        squared = np.minimum((residual / CAUCHY_SCALE) ** 2, MAX_SQUARED_RESIDUAL)
        cost = CAUCHY_SCALE**2 * np.log1p(squared)
        inward = residual * [1.0, 1.0, -1.0, -1.0] > 0
        # Against an edge that something hides, which may be anywhere within.
        hides = np.where(inward, self.edges.hidden_odds[:, None], 0.0)
        likelihood = np.exp(-cost / 2)
        total = likelihood + hides
        return likelihood / (total * (1 + squared)), -2 * np.log(total / (1 + hides))

    def averaged(self, means: F64, covariances: F64, *, steps: int) -> tuple[F64, F64]:
        """Means (N, 8) and covariances (N, 8, 8), by `steps` Gauss-Newton steps from several headings around `means`.

        The covariances (N, 8, 8) of these give the spacing of the headings, and the other states at each.
        """
        yaw_sigma = np.sqrt(covariances[:, _YAW, _YAW])
        states = means[:, None] + YAW_SIGMAS[:, None] * (covariances[:, _YAW] / yaw_sigma[:, None])[:, None]
        for _ in range(steps):
            normal, right, cost = self.linearised(states)
            step = np.linalg.solve(normal, right[..., None])[..., 0]
            states[..., _REST] += step
        log_odds = ((step * right).sum(2) - cost - np.linalg.slogdet(normal)[1]) / 2
        shares = softmax(log_odds)
        mean = (shares[..., None] * states).sum(1)
        deviations = states - mean[:, None]
        spread = (shares[..., None] * deviations).swapaxes(1, 2) @ deviations
        spread[:, _REST[:, None], _REST] += (shares[..., None, None] * np.linalg.inv(normal)).sum(1)
        spread[:, _YAW, _YAW] += (yaw_sigma * (YAW_SIGMAS[1] - YAW_SIGMAS[0])) ** 2 / 12
        return mean, spread

    def most_certain(self, covariances: F64) -> tuple[F64, F64]:
        """The time at which the position of each box is most certain, between cloud and images.

        The speed is uncertain, so that time is near the measurement with most information.

        Args:
            covariances: (N, 8, 8) of the states.

        Returns:
            (N,) seconds after the time of the prior; (N, 3, 8) x, y and yaw at that time by the states.
        """
        turn, starts = self.turn, self.starts
        common = (turn * covariances[:, :2, 6:]).sum((1, 2))
        later_s = -common / (covariances[:, 6, 6] + covariances[:, 7, 7])
        measured_s = self.edges.later_s
        first_s, last_s = np.minimum.reduceat(measured_s, starts), np.maximum.reduceat(measured_s, starts)
        later_s = np.clip(later_s, np.minimum(first_s, 0.0), np.maximum(last_s, 0.0))
        moved = np.zeros((len(turn), 3, 8))
        moved[:, :, :3] = np.eye(3)
        moved[:, :2, 6:] = turn * later_s[:, None, None]
        return later_s, moved


def _resized(sizes: F64, more: F64) -> F64:
    """Sizes (N, 3) that grow, within bounds."""
    return np.minimum(np.maximum(sizes + more, MIN_SIZE * sizes), MAX_SIZE * sizes)


def refine_boxes(boxes: Boxes3D, prior: BoxPrior, edges: MeasuredEdges, outline: Outline) -> RefinedBoxes:
    """Boxes fitted to their matched 2D boxes.

    Args:
        boxes: N boxes, each with at least one pair.
        prior: Their prior.
        edges: P pairs, sorted by the box, whose boxes are wholly in view.
        outline: Outline of the box of each pair.
    """
    n = len(boxes)
    problem = _Problem.of(boxes, prior, edges, outline)
    mean, covariances = problem.averaged(np.zeros((n, 8)), prior.covariances, steps=2)
    mean, covariances = problem.averaged(mean, covariances, steps=1)
    both = np.zeros((n, 2, 8))
    both[:, 1] = mean
    _, _, costs = problem.linearised(both)
    pull = np.linalg.solve(prior.covariances[:, :3, :3], mean[:, :3, None])[..., 0]
    accepted = (
        (costs[:, 1] <= costs[:, 0])
        & ((pull * mean[:, :3]).sum(1) <= MAX_SQUARED_STEP)
        & (np.abs(mean[:, _YAW]) < np.pi / 2)
    )
    accepted &= np.isfinite(mean).all(1) & np.isfinite(covariances).all((1, 2))
    mean = np.where(accepted[:, None], mean, 0.0)
    covariances = np.where(accepted[:, None, None], covariances, prior.covariances)
    # The yaw of the box follows the apparent one by a share.
    follows = np.ones((n, 8))
    follows[:, _YAW] = prior.yaw_shares
    mean, covariances = follows * mean, follows[:, :, None] * covariances * follows[:, None]
    covariances[:, _YAW, _YAW] += prior.yaw_rests
    later_s, moved = problem.most_certain(covariances)
    return RefinedBoxes(
        centers_xy=boxes.centers[:, :2] + (moved @ mean[..., None])[:, :2, 0],
        yaws=boxes.yaws + mean[:, _YAW],
        sizes=_resized(boxes.sizes, mean[:, 3:6]),
        covariances=moved @ covariances @ moved.swapaxes(1, 2),
        later_s=later_s,
        accepted=accepted,
        costs=np.ascontiguousarray(costs[:, 1]),
    )


def with_turned(boxes: Boxes3D, edges: MeasuredEdges) -> tuple[Boxes3D, MeasuredEdges, I64]:
    """The boxes, and turned copies of those with a 2D box that are longer than wide and of unknown heading.

    Returns:
        N + T boxes, the pairs of all of them, and (N + T,) the row of the box that each stands for.
    """
    numbers = np.arange(len(boxes))
    is_long = boxes.sizes[:, 0] > MIN_ELONGATION * boxes.sizes[:, 1]
    is_unknown = is_long & (boxes.covariances[:, 2, 2] > MAX_YAW_SIGMA_RAD**2)
    is_unknown &= np.bincount(edges.rows, minlength=len(boxes)) > 0
    unknown = np.flatnonzero(is_unknown)
    if not len(unknown):
        return boxes, edges, numbers
    covariances = boxes.covariances.copy()
    share = EIGHTH_TURN_SIGMA_RAD / np.sqrt(covariances[unknown, 2, 2])
    covariances[unknown, 2] *= share[:, None]
    covariances[unknown, :, 2] *= share[:, None]
    either = replace(boxes, covariances=covariances)
    turned = either.select(unknown)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(
        turned, yaws=wrap_angle(turned.yaws + np.pi / 2), covariances=quarter @ turned.covariances @ quarter.T
    )
    again = np.flatnonzero(is_unknown[edges.rows])
    number = len(boxes) + np.searchsorted(unknown, edges.rows[again])
    rows = np.concatenate([edges.rows, number]).astype(np.int64)
    edges = replace(edges.select(np.concatenate([np.arange(len(edges)), again])), rows=rows)
    return either.joined(turned), edges, np.concatenate([numbers, unknown])


def better_turned(objects: I64, found: RefinedBoxes, turned_of: I64) -> Bools:
    """(M,) whether each fitted box is likelier than its turned copy; the original wins a tie.

    `objects` (M,) are rows of `with_turned`, rising, which also returned `turned_of`.
    """
    stands_for = turned_of[objects]
    is_turned = stands_for != objects
    costs = np.where(found.accepted, found.costs + TURNED_COST * is_turned, np.inf)
    order = np.lexsort((objects, costs, stands_for))
    better = np.zeros(len(objects), np.bool_)
    better[order[first_of_runs(stands_for[order])]] = True
    return better
