"""Vans: true objects that are right as a car and as a truck, because data sets and detectors count them as either."""

import numpy as np

from lidcam.pipeline.core.arrays import I32, Bools, Indices, Names
from lidcam.pipeline.core.settings.config import Config

VAN = "van"
"""The truth's own name of such an object."""


class Vans:
    """Which true objects are vans, if the settings have a car and a truck and no van; and the class that counts."""

    def __init__(self, config: Config) -> None:
        names = config.class_names
        self._ids = [names.index(name) for name in ("car", "truck")] if {"car", "truck"} <= {*names} else []

    def among(self, class_ids: I32, labels: Names) -> Bools:
        """(T,) whether true objects of these classes and labels are vans."""
        return np.asarray(np.isin(class_ids, self._ids) & (np.char.lower(labels) == VAN))

    def fit(self, class_ids: I32, is_van: Bools, found_ids: I32) -> Bools:
        """(P,) whether boxes of classes (P,) can be right for the true objects that they are compared with (P,)."""
        return np.asarray((class_ids == found_ids) | (is_van & np.isin(found_ids, self._ids)))


def as_found(class_ids: I32, matches: I32 | Indices, found_ids: I32) -> I32:
    """(T,) classes of true objects; that of a van is the one of the box that shows it: `matches` (N,), of -1 none."""
    shown, right = class_ids.copy(), matches >= 0
    shown[matches[right]] = found_ids[right]
    return shown
