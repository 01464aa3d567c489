"""Places of the labels of objects in a 3D view: above their roofs, and elsewhere where they would cover each other."""

from collections.abc import Callable, Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.writers.drawing import DrawnObjects
from lidcam.writers.viewpoint import SceneSurvey, Viewpoint

_VIEW_PX, _LINE_PX, _LETTER_PX, _PADDING_PX = 480.0, 26.0, 7.5, 18.0
"""Height of a usual view, height of a label, width of its letters, and what is left and right of them."""


class LabelPlaces:
    """Places of the labels of frames, as the eye sees them that `place_eye` gives for the frames so far."""

    def __init__(self, survey: SceneSurvey, place_eye: Callable[[SceneSurvey], Viewpoint], fov_y_deg: float) -> None:
        self._survey, self._place_eye, self._fov_y_deg = survey, place_eye, fov_y_deg
        self._eye: Viewpoint | None = None
        self._is_settled = False

    def of(self, drawn: DrawnObjects) -> F64:
        """(N, 3) places of the labels of the strong objects of a frame; the roofs of the others."""
        places, strong = drawn.roofs, drawn.strong
        if not strong.any():
            return places
        if self._eye is None or self._is_settled != self._survey.is_complete:  # at first, and once that is settled
            self._eye, self._is_settled = self._place_eye(self._survey), self._survey.is_complete
        texts = [label for label, shown in zip(drawn.labels, strong.tolist(), strict=True) if shown]
        places[strong] = labels_apart(places[strong], texts, self._eye, self._fov_y_deg)
        return places


def labels_apart(tops: F64, texts: Sequence[str], view: Viewpoint, fov_y_deg: float) -> F64:
    """(N, 3) places of labels, straight above the roofs: near ones stay, those behind them make way upwards.

    Where the view ends above, they make way downwards.

    Args:
        tops: (N, 3) middle of the top of each object, in the site frame.
        texts: (N,) labels.
        view: The eye from which they are apart; from others they are nearly so.
        fov_y_deg: Its vertical field of view.
    """
    ahead = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
    right = np.array([view.up[1], -view.up[0], 0.0])
    upward = np.cross(right, ahead)
    away, px = tops - view.eye, _VIEW_PX / 2 / np.tan(np.radians(fov_y_deg) / 2)
    depth, up = away @ ahead, away @ upward
    in_view = (depth > 0) & (up > -0.75 * depth)
    x, y = (px * along / np.where(in_view, depth, 1.0) for along in (away @ right, up))
    y += _LINE_PX  # viewers hang a label below its place
    widths = np.array([len(text) * _LETTER_PX + _PADDING_PX for text in texts])
    is_placed = np.zeros(len(tops), np.bool_)
    order = np.argsort(depth, kind="stable")
    for row in order[in_view[order]].tolist():
        beside = y[is_placed & (np.abs(x - x[row]) < (widths + widths[row]) / 2)]
        higher, lower = (_free(float(y[row]), beside, step) for step in (_LINE_PX, -_LINE_PX))
        y[row] = higher if higher < _VIEW_PX / 2 else lower
        is_placed[row] = True
    # A point that is raised by z is seen at (up + z upward_z) / (depth + z ahead_z).
    slope = y / px
    raised_m = np.where(in_view, (slope * depth - up) / (upward[2] - slope * ahead[2]), 0.0)
    return np.asarray(tops + np.column_stack([np.zeros((len(tops), 2)), raised_m]))


def _free(y: float, taken: F64, step: float) -> float:
    """The first height from `y` on, up or down, that is a step away from all that are taken."""
    while (covered := taken[np.abs(taken - y) < abs(step)]).size:
        y = float(covered.max() if step > 0 else covered.min()) + step * (1 + 1e-9)  # ever on, so there is a last step
    return y
