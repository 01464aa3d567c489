"""The kinds of road users that learned scores and the network `traffic` know."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import I64, Bools
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES, ClassPrior

KINDS = ("background", "car", "pedestrian", "cyclist", "large vehicle")
"""Kinds of clusters, in the order of the probabilities. A large vehicle is a van, a truck or a bus."""

KIND_OF_NAME = {"car": 1, "pedestrian": 2, "bicycle": 3, "truck": 4, "bus": 4}
"""Rows of `KINDS` by the names of the classes of the roads; labels of other classes count, too."""

MAX_SIZE_FACTOR = 2.0
"""Maximum ratio of a class's typical size to that of the roads: other sizes were not in training."""


def kinds_of(classes: Sequence[ClassPrior]) -> Bools:
    """(C, 5) the `KINDS` of each class, by name and labels; raises ConfigError if one is of no kind or another size."""
    found = np.zeros((len(classes), len(KINDS)), np.bool_)
    roads = {prior.name: prior for prior in ROAD_CLASSES}
    for row, prior in enumerate(classes):
        names = [name for name in KIND_OF_NAME if name in prior.known_as]
        fitting = [name for name in names if _is_of_size(prior, roads[name])]
        if not fitting:
            raise ConfigError(
                "settings: detect3d.score learned knows cars, pedestrians, bicycles, trucks and buses of full size, by "
                f"name or label; expected classes of these, found {prior.name}; set detect3d.score to geometric"
            )
        found[row, [KIND_OF_NAME[name] for name in names]] = True
    return found


def knows(classes: Sequence[ClassPrior]) -> bool:
    """Whether all classes are of `KINDS`, and of the size that was trained."""
    try:
        kinds_of(classes)
    except ConfigError:
        return False
    return True


def groups_of(classes: Sequence[ClassPrior]) -> I64:
    """(C,) number of a group for each class: those of one of `KINDS` share one, as scores do not tell them apart."""
    return kinds_of(classes).argmax(1) if knows(classes) else len(KINDS) + np.arange(len(classes))


def _is_of_size(prior: ClassPrior, other: ClassPrior) -> bool:
    ratio = np.abs(np.log(np.divide(prior.size_m, (other.size_m, *other.kinds_m))))
    return bool((ratio <= np.log(MAX_SIZE_FACTOR)).all(1).any())
