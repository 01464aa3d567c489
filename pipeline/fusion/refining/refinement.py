"""Boxes fitted to the edges of 2D boxes: a small robust least-squares problem for each, all of them at once.

Unknown are x, y, yaw, length and width of a box, and its speed where the images were taken at another time than the
cloud. The prior is the box with its covariance; the residuals are the differences of the edges of its 2D boxes and
those of its projection. At a given yaw the edges are almost linear in all the rest; in the yaw they are not: when
another corner becomes the outermost, the slope changes its sign, and there may be several minima. So some yaws around
the prior are tried, the rest is solved for each by Gauss-Newton steps, and the solutions are averaged by their
probabilities (Laplace's approximation of the integral over the rest). This is done twice, the second time around the
first average. The mean of the distribution errs less than its largest value, and its covariance tells when two headings
fit alike.

Residuals are weighed by a Cauchy distribution (iteratively reweighted), so that a wrong 2D box does little harm.

A rider of whom the lidars see little more than the shoulders may sit along the points or across them. The images tell:
a box of unknown heading is fitted once more from the heading at right angles, and the likelier fit is taken.
"""

from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, first_of_runs
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import rotations_2d, wrap_angle
from lidcam.pipeline.fusion.projection import Outline, project_edges
from lidcam.pipeline.fusion.refining.box_prior import MAX_YAW_RAD, SQUARE, BoxPrior
from lidcam.pipeline.fusion.refining.edges import MeasuredEdges

YAWS, SPAN = 5, 2.5
"""Number of headings that are tried at once, and their reach to both sides, standard deviations."""

CAUCHY = 3.0
"""Residuals of so many standard deviations weigh half."""

BORDER = 3.0
"""An edge of a 2D box this many standard deviations from the border of the image may be the border."""

GATE = 16.27
"""Square of the largest step in standard deviations of the prior: 99.9 % for three degrees of freedom."""

MIN_SIZE, MAX_SIZE = 0.5, 1.5
"""Bounds of a refined length and width, as shares of the prior's."""

EITHER_YAW_RAD = np.pi / 2 / np.sqrt(12.0)
"""Standard deviation of a heading of which it is known that it is no farther than an eighth of a turn away."""

TURNED_SHARE = 0.3
"""Share of the boxes of unknown heading that are turned by more than an eighth: 32 of 111 cyclists in three simulated
recordings."""

TURNED_COST = 2 * np.log(1 / TURNED_SHARE - 1)

_OFFSETS = np.linspace(-SPAN, SPAN, YAWS)

_YAW = 2
_REST = np.array([0, 1, 3, 4, 5, 6])
"""Rows of `box_prior.STATES` that are solved for at a given yaw."""


class RefinedBoxes(NamedTuple):
    """N boxes after refinement.

    Attributes:
        centers_xy: (N, 2) float64 metres.
        yaws: (N,) float64 radians.
        lengths_widths: (N, 2) float64 metres.
        covariances: (N, 3, 3) float64 over x, y and yaw.
        later_s: (N,) float64, how much later than in the prior the object is where its box says.
        accepted: (N,) whether the result explains the images better than the prior, and is not too far from it; else
            the row is that of the prior.
        costs: (N,) float64 twice the negative logarithm of the probability of the images and the fit; less is better.
    """

    centers_xy: F64
    yaws: F64
    lengths_widths: F64
    covariances: F64
    later_s: F64
    accepted: Bools
    costs: F64


class _Problem(NamedTuple):
    """N boxes, and P pairs with an outline of the box for each.

    Attributes:
        boxes: Of the prior.
        prior: Its distributions.
        edges: Sorted by the box, of which each has some.
        outline: Of the box of each pair.
        turn: (N, 2, 2) from the axes of the boxes to those of the site.
        turn_of_pair: (P, 2, 2) the same of the box of each pair.
        starts: (N,) first pair of each box.
        near: (P, 1, 4) whether each edge is so near to the border of the image that it may be the border.
        known: (N, 1, 6, 6) information of the prior over all states but the yaw.
    """

    boxes: Boxes3D
    prior: BoxPrior
    edges: MeasuredEdges
    outline: Outline
    turn: F64
    turn_of_pair: F64
    starts: Indices
    near: Bools
    known: F64

    @classmethod
    def of(cls, boxes: Boxes3D, prior: BoxPrior, edges: MeasuredEdges, outline: Outline) -> Self:
        """The problem, with what is the same in all steps."""
        turn, starts = rotations_2d(boxes.yaws), np.flatnonzero(first_of_runs(edges.rows))
        near = np.minimum(edges.xyxy, edges.cameras.limits - edges.xyxy) < BORDER * edges.sigma_px
        known = prior.information[:, None, _REST[:, None], _REST]
        return cls(boxes, prior, edges, outline, turn, turn[edges.rows], starts, near[:, None], known)

    def projected(self, states: F64) -> tuple[F64, F64]:
        """The edges of the boxes in given states, at the times of the images.

        Args:
            states: (N, K, 7) in the order of `STATES`, less the prior's.

        Returns:
            (P, K, 4) edges, pixels, and (P, K, 4, 7) their derivatives by `projection.PARAMETERS`.
        """
        boxes, edges, rows = self.boxes, self.edges, self.edges.rows
        at_pairs, pairs = states[rows], np.arange(len(rows)).repeat(states.shape[1])
        moved = at_pairs[..., 5:] @ self.turn_of_pair.swapaxes(1, 2) * edges.later_s[:, None, None]
        centers, sizes, yaws = (values.take(rows[pairs], 0) for values in (boxes.centers, boxes.sizes, boxes.yaws))
        centers[:, :2] += (at_pairs[..., :2] + moved).reshape(len(pairs), 2)
        extent, more = sizes[:, :2], at_pairs[..., 3:5].reshape(len(pairs), 2)
        sizes[:, :2] = np.minimum(np.maximum(extent + more, MIN_SIZE * extent), MAX_SIZE * extent)
        yaws += at_pairs[..., _YAW].reshape(len(pairs))
        found = project_edges(centers, sizes, yaws, edges.cameras, self.outline, rows=pairs)
        return found.xyxy.reshape(*moved.shape[:2], 4), found.jacobian.reshape(*moved.shape[:2], 4, 7)

    def linearised(self, states: F64) -> tuple[F64, F64, F64]:
        """The linear systems of a Gauss-Newton step, at a given yaw, from each of the states that are tried.

        An edge of a 2D box near the border of its image may be the border: it is compared with the edge of the
        projection clipped to the image, and where that is the border, a small change of the box changes nothing.

        Args:
            states: (N, K, 7) less the prior's.

        Returns:
            (N, K, 6, 6) normal matrices over all states but the yaw; (N, K, 6) their right sides; (N, K) twice the
            negative logarithm of the probability.
        """
        xyxy, jacobian = self.projected(states)
        edges = self.edges
        limits, sigma_px = edges.cameras.limits[:, None], edges.sigma_px[:, None]
        shown = np.where(self.near, np.minimum(np.maximum(xyxy, 0.0), limits), xyxy)
        residual = (edges.xyxy[:, None] - shown) / sigma_px
        squared = (residual / CAUCHY) ** 2
        weights = np.where(shown == xyxy, 1 / (1 + squared), 0.0)[..., None]
        by_speed = jacobian[..., :2] @ self.turn_of_pair[:, None] * edges.later_s[:, None, None, None]
        slopes = np.concatenate([jacobian[..., [0, 1, 3, 4]], by_speed], 3) / sigma_px[..., None]
        weighed = (slopes * weights).swapaxes(2, 3)
        drawn_back = states @ self.prior.information
        normal = np.add.reduceat(weighed @ slopes, self.starts) + self.known
        right = np.add.reduceat((weighed @ residual[..., None])[..., 0], self.starts) - drawn_back[..., _REST]
        cost = np.add.reduceat(CAUCHY**2 * np.log1p(squared).sum(2), self.starts) + (drawn_back * states).sum(2)
        return normal, right, cost

    def averaged(self, means: F64, covariances: F64, *, steps: int) -> tuple[F64, F64]:
        """Means (N, 7) and covariances (N, 7, 7), by Gauss-Newton steps from each of some headings.

        Args:
            means: (N, 7) states around which headings are tried.
            covariances: (N, 7, 7) of these; they say how far apart the headings are, and how the rest goes with them.
            steps: Their number.
        """
        yaw_sigma = np.sqrt(covariances[:, _YAW, _YAW])
        states = means[:, None] + _OFFSETS[:, None] * (covariances[:, _YAW] / yaw_sigma[:, None])[:, None]
        for _ in range(steps):
            normal, right, cost = self.linearised(states)
            step = np.linalg.solve(normal, right[..., None])[..., 0]
            states[..., _REST] += step
        log_odds = ((step * right).sum(2) - cost - np.linalg.slogdet(normal)[1]) / 2
        shares = np.exp(log_odds - log_odds.max(1, keepdims=True))
        shares /= shares.sum(1, keepdims=True)
        mean = (shares[..., None] * states).sum(1)
        apart = states - mean[:, None]
        spread = (shares[..., None] * apart).swapaxes(1, 2) @ apart
        spread[:, _REST[:, None], _REST] += (shares[..., None, None] * np.linalg.inv(normal)).sum(1)
        spread[:, _YAW, _YAW] += (yaw_sigma * (_OFFSETS[1] - _OFFSETS[0])) ** 2 / 12
        return mean, spread

    def best_known(self, covariances: F64) -> tuple[F64, F64]:
        """When the place of each box is known best, between cloud and images.

        The speed is hardly known, so the place is known best at the time of what tells most of it: the more an image
        says, the nearer to the time of the image.

        Args:
            covariances: (N, 7, 7) of the states.

        Returns:
            (N,) seconds after the time of the prior; (N, 3, 7) x, y and yaw at that time by the states.
        """
        turn, starts = self.turn, self.starts
        common = (turn * covariances[:, :2, 5:]).sum((1, 2))
        later_s = -common / (covariances[:, 5, 5] + covariances[:, 6, 6])
        measured_s = self.edges.later_s
        first_s, last_s = np.minimum.reduceat(measured_s, starts), np.maximum.reduceat(measured_s, starts)
        later_s = np.clip(later_s, np.minimum(first_s, 0.0), np.maximum(last_s, 0.0))
        moved = np.zeros((len(turn), 3, 7))
        moved[:, :, :3] = np.eye(3)
        moved[:, :2, 5:] = turn * later_s[:, None, None]
        return later_s, moved


def predicted_edges(boxes: Boxes3D, edges: MeasuredEdges, outline: Outline) -> tuple[F64, F64, Bools]:
    """The edges of the boxes as they are.

    Args:
        boxes: N boxes.
        edges: P pairs.
        outline: Of the box of each pair.

    Returns:
        (P, 4) edges in pixels; (P, 4, 3) their derivatives by x, y and yaw; (P,) whether they are valid.
    """
    rows = edges.rows
    found = project_edges(boxes.centers[rows], boxes.sizes[rows], boxes.yaws[rows], edges.cameras, outline)
    return found.xyxy, found.jacobian[..., :3].copy(), found.valid


def refine_boxes(boxes: Boxes3D, prior: BoxPrior, edges: MeasuredEdges, outline: Outline) -> RefinedBoxes:
    """Boxes fitted to the 2D boxes that are matched with them.

    Args:
        boxes: N boxes, each with at least one pair.
        prior: Their prior.
        edges: P pairs, sorted by the box; their boxes are in view wholly.
        outline: Of the box of each pair.
    """
    n = len(boxes)
    problem = _Problem.of(boxes, prior, edges, outline)
    mean, covariances = problem.averaged(np.zeros((n, 7)), prior.covariances, steps=2)
    mean, covariances = problem.averaged(mean, covariances, steps=1)
    both = np.zeros((n, 2, 7))
    both[:, 1] = mean
    _, _, costs = problem.linearised(both)
    pull = np.linalg.solve(prior.covariances[:, :3, :3], mean[:, :3, None])[..., 0]
    accepted = (
        (costs[:, 1] <= costs[:, 0]) & ((pull * mean[:, :3]).sum(1) <= GATE) & (np.abs(mean[:, _YAW]) < np.pi / 2)
    )
    accepted &= np.isfinite(mean).all(1) & np.isfinite(covariances).all((1, 2))
    mean = np.where(accepted[:, None], mean, 0.0)
    covariances = np.where(accepted[:, None, None], covariances, prior.covariances)
    # The yaw of the box follows the one that images show by a share.
    follows = np.ones((n, 7))
    follows[:, _YAW] = prior.yaw_shares
    mean, covariances = follows * mean, follows[:, :, None] * covariances * follows[:, None]
    covariances[:, _YAW, _YAW] += prior.yaw_rests
    later_s, moved = problem.best_known(covariances)
    extent = boxes.sizes[:, :2]
    return RefinedBoxes(
        boxes.centers[:, :2] + (moved @ mean[..., None])[:, :2, 0],
        boxes.yaws + mean[:, _YAW],
        np.clip(extent + mean[:, 3:5], MIN_SIZE * extent, MAX_SIZE * extent),
        moved @ covariances @ moved.swapaxes(1, 2),
        later_s,
        accepted,
        np.ascontiguousarray(costs[:, 1]),
    )


def with_turned(boxes: Boxes3D, edges: MeasuredEdges) -> tuple[Boxes3D, MeasuredEdges, I64]:
    """The boxes, and once more, turned, those with a 2D box that are longer than wide and of unknown heading.

    Args:
        boxes: N boxes.
        edges: Their pairs.

    Returns:
        N + T boxes, the pairs of all of them, and (N + T,) the row of the given box that each stands for.
    """
    own = np.arange(len(boxes))
    is_long = boxes.sizes[:, 0] > SQUARE * boxes.sizes[:, 1]
    is_unknown = is_long & (boxes.covariances[:, 2, 2] > MAX_YAW_RAD**2)
    if is_unknown.any():
        is_unknown &= np.bincount(edges.rows, minlength=len(boxes)) > 0
    unknown = np.flatnonzero(is_unknown)
    if not len(unknown):
        return boxes, edges, own
    covariances = boxes.covariances.copy()
    share = EITHER_YAW_RAD / np.sqrt(covariances[unknown, 2, 2])
    covariances[unknown, 2] *= share[:, None]
    covariances[unknown, :, 2] *= share[:, None]
    either = replace(boxes, covariances=covariances)
    turned = either.select(unknown)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(
        turned,
        yaws=wrap_angle(turned.yaws + np.pi / 2),
        covariances=quarter @ turned.covariances @ quarter.T,
    )
    again = np.flatnonzero(is_unknown[edges.rows])
    number = len(boxes) + np.searchsorted(unknown, edges.rows[again])
    rows = np.concatenate([edges.rows, number]).astype(np.int64)
    edges = replace(edges.select(np.concatenate([np.arange(len(edges)), again])), rows=rows)
    return either.joined(turned), edges, np.concatenate([own, unknown])


def better_turned(objects: I64, found: RefinedBoxes, turned_of: I64) -> Bools:
    """(M,) whether each fitted box is likelier than the other one that stands for the same box.

    Of two that are equally likely it is the one that is not turned.

    Args:
        objects: (M,) row of each in what `with_turned` gives, rising.
        found: The M fitted boxes.
        turned_of: See there.
    """
    stands_for = turned_of[objects]
    is_turned = stands_for != objects
    if not is_turned.any():
        return np.ones(len(objects), np.bool_)
    costs = np.where(found.accepted, found.costs + TURNED_COST * is_turned, np.inf)
    order = np.lexsort((objects, costs, stands_for))
    better = np.zeros(len(objects), np.bool_)
    better[order[first_of_runs(stands_for[order])]] = True
    return better
