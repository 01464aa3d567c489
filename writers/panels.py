"""Arrangement of the panels in a viewer's window: the scene, the images in their own aspect, the plots."""

from collections.abc import Sequence
from math import ceil
from operator import itemgetter
from statistics import median
from typing import Literal, NamedTuple

WINDOW_PX = (1600, 920)
"""The panels' share of a usual window."""

TITLE_PX = 24
MAX_IMAGE_SHARE = 0.46
WORTH_A_LOW_SCENE = 1.25
"""Images go above the scene, which makes it low, if they become wider by this factor."""

MIN_PLOT_SHARE = 0.15
"""Share of the images' area for plots; a smaller one is left empty."""


PERSPECTIVE_SHARE, SIDE_BY_SIDE = 0.58, 1.5
"""Share of the scene's area for its view in perspective; aspect from which on the view from above is beside it."""


OBJECTS_TITLE, SKEW_TITLE = "Objects: all blue, confirmed green", "Sync skew (ms)"
"""Plot titles; they replace legends, which hide the curves."""


class Panels(NamedTuple):
    """An arrangement."""

    side: Literal["right", "top"]  # Where the images are, seen from the scene
    columns: int  # Columns of the grid of images
    image_share: float  # Share of the window's width (right) or height (top) for the images
    plot_share: float  # Share of the images' area for the plots; 0: the plots are behind the scene
    scene_aspect: float  # Width of the scene divided by its height


class ScenePanels(NamedTuple):
    """The scene in perspective, and from above beside or below it."""

    direction: Literal["row", "column"]  # Whether they are side by side
    share: float  # Share of the first
    aspect: float  # Width of the view in perspective divided by its height
    above_aspect: float  # The same of the view from above


def scene_panels(aspect: float) -> ScenePanels:
    """The two views of the scene in a space of this aspect."""
    share = PERSPECTIVE_SHARE
    if aspect >= SIDE_BY_SIDE:
        return ScenePanels("row", share, aspect * share, aspect * (1 - share))
    return ScenePanels("column", share, aspect / share, aspect / (1 - share))


def arrange(aspects: Sequence[float]) -> Panels:
    """The arrangement in which images of these aspects, width by height, are large and the scene is not too low."""
    width, height = WINDOW_PX
    if not aspects:
        return Panels("right", 1, 0.0, 0.0, width / (height - TITLE_PX))
    count, aspect = len(aspects), median(aspects)
    found = []
    for columns in range(1, count + 1):
        rows = ceil(count / columns)
        image_px = min(MAX_IMAGE_SHARE * width / columns, (height / rows - TITLE_PX) * aspect)
        used = rows * (image_px / aspect + TITLE_PX) / height
        found.append((image_px, _panels("right", columns, columns * image_px / width, 1 - used)))
        image_px = min(width / columns, (MAX_IMAGE_SHARE * height / rows - TITLE_PX) * aspect)
        used = columns * image_px / width
        found.append((image_px, _panels("top", columns, rows * (image_px / aspect + TITLE_PX) / height, 1 - used)))
    right, top = (max((one for one in found if one[1].side == side), key=itemgetter(0)) for side in ("right", "top"))
    return top[1] if top[0] > WORTH_A_LOW_SCENE * right[0] else right[1]


def _panels(side: Literal["right", "top"], columns: int, image_share: float, left_over: float) -> Panels:
    width, height = WINDOW_PX
    scene_width = width * (1 - image_share) if side == "right" else width
    scene_height = height * (1 - image_share) if side == "top" else height
    return Panels(
        side,
        columns,
        round(image_share, 3),
        round(left_over, 3) if left_over >= MIN_PLOT_SHARE else 0.0,
        scene_width / (scene_height - TITLE_PX),
    )
