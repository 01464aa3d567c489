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
"""

from typing import NamedTuple, Self

import numpy as np

from pipeline.core.arrays import F64, Bools, first_of_runs
from pipeline.core.detections import Boxes3D
from pipeline.fusion.outline import Outline
from pipeline.fusion.projection import project_edges
from pipeline.fusion.refining.box_prior import BoxPrior
from pipeline.fusion.refining.fit_kernels import averaged_states, boxes_at, normal_equations
from pipeline.fusion.refining.measured_edges import MeasuredEdges
from pipeline.fusion.small_matrices import inverse, solve

__all__ = ["RefinedBoxes", "predicted_edges", "refine_boxes"]

YAWS, SPAN = 5, 2.5
"""How many headings are tried at once, and how many standard deviations they reach to both sides."""

CAUCHY = 3.0
"""Residuals of so many standard deviations weigh half."""

BORDER = 3.0
"""An edge of a 2D box this many standard deviations from the border of the image may be the border."""

GATE = 16.27
"""Square of the largest step in standard deviations of the prior: 99.9 % for three degrees of freedom."""

LEAST_SIZE, MOST_SIZE = 0.5, 1.5
"""Bounds of a refined length and width, as shares of the prior's."""

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
    """N boxes, and P pairs with an outline of the box for each."""

    boxes: Boxes3D
    prior: BoxPrior
    edges: MeasuredEdges
    outline: Outline
    cosines: F64
    sines: F64

    @classmethod
    def of(cls, boxes: Boxes3D, prior: BoxPrior, edges: MeasuredEdges, outline: Outline) -> Self:
        """The problem, with what is the same in all steps."""
        return cls(boxes, prior, edges, outline, np.cos(boxes.yaws), np.sin(boxes.yaws))

    def linearised(self, states: F64) -> tuple[F64, F64, F64]:
        """What `normal_equations` gives at states (N, K, 7) less the prior's."""
        boxes, edges = self.boxes, self.edges
        turns = self.cosines, self.sines
        placed = boxes.centers, boxes.sizes, boxes.yaws
        tried = boxes_at(states, edges.rows, edges.later_s, *placed, *turns, LEAST_SIZE, MOST_SIZE)
        pairs = np.repeat(np.arange(len(edges)), states.shape[1])
        found = project_edges(*tried, edges.cameras, self.outline, rows=pairs)
        measured = edges.xyxy, edges.sigma_px, edges.cameras.limits, edges.later_s
        return normal_equations(
            states, self.prior.information, edges.rows, found.xyxy, found.jacobian, *measured, *turns, BORDER, CAUCHY
        )

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
            found, log_det = solve(normal, right)
            states[..., _REST] += found[..., 0]
        log_odds = -(cost - (found[..., 0] * right[..., 0]).sum(2) + log_det) / 2
        about_each = (yaw_sigma * (_OFFSETS[1] - _OFFSETS[0])) ** 2 / 12
        return averaged_states(states, log_odds, np.ascontiguousarray(found[..., 1:]), about_each)

    def best_known(self, covariances: F64) -> tuple[F64, F64]:
        """When the place of each box is known best, between cloud and images.

        The speed is hardly known, so the place is known best at the time of what tells most of it: the more an image
        says, the nearer to the time of the image.

        Args:
            covariances: (N, 7, 7) of the states.

        Returns:
            (N,) seconds after the time of the prior; (N, 3, 7) x, y and yaw at that time by the states.
        """
        turn = np.column_stack([self.cosines, -self.sines, self.sines, self.cosines]).reshape(-1, 2, 2)
        common = np.einsum("nij,nij->n", turn, covariances[:, :2, 5:])
        later_s = -common / (covariances[:, 5, 5] + covariances[:, 6, 6])
        starts = np.flatnonzero(first_of_runs(self.edges.rows))
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
        prior: What is known of them.
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
    inner = np.einsum("ni,nij,nj->n", mean[:, :3], inverse(prior.covariances[:, :3, :3]), mean[:, :3])
    accepted = (costs[:, 1] <= costs[:, 0]) & (inner <= GATE) & (np.abs(mean[:, _YAW]) < np.pi / 2)
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
        boxes.centers[:, :2] + np.einsum("nij,nj->ni", moved, mean)[:, :2],
        boxes.yaws + mean[:, _YAW],
        np.clip(extent + mean[:, 3:5], LEAST_SIZE * extent, MOST_SIZE * extent),
        np.einsum("nij,njk,nlk->nil", moved, covariances, moved),
        later_s,
        accepted,
        np.ascontiguousarray(costs[:, 1]),
    )
