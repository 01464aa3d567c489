"""Counts of the objects of a channel that differ, by class."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import Bools, Indices
from lidcam.pipeline.evaluation.comparison.object_changes import KINDS, PAIR_KINDS, Changes, Kind


class Tally:
    """Counts the objects of one channel; `units` has the kinds that are measured of objects that both results have."""

    def __init__(self, class_names: Sequence[str], allowed: Collection[Kind], units: dict[Kind, str]) -> None:
        self.class_names, self._units = tuple(class_names), units
        self._is_allowed = np.array([kind in allowed for kind in KINDS])
        counted = ("a", "b", "both", "equal", "different", "not_allowed", *KINDS)
        self._counts = {name: np.zeros(len(self.class_names), np.int64) for name in counted}
        self._largest = np.zeros((len(self.class_names), len(PAIR_KINDS)))

    def add_changes(self, changes: Changes, first_classes: Indices, second_classes: Indices) -> None:
        """Take in a frame, with the class of each object of A and B: a row of the names.

        An object that both have counts with its class in A.
        """
        paired, lost, new = first_classes[changes.first], first_classes[changes.lost], second_classes[changes.new]
        changed = changes.is_changed.any(1)
        forbidden = (changes.is_changed & ~self._is_allowed[2:]).any(1)
        alone = [rows for rows, is_allowed in zip((lost, new), self._is_allowed, strict=False) if not is_allowed]
        found = {
            "a": first_classes,
            "b": second_classes,
            "both": paired,
            "equal": paired[~changed],
            "different": np.concatenate([paired[changed], lost, new]),
            "not_allowed": np.concatenate([paired[forbidden], *alone]),
            "lost": lost,
            "new": new,
        } | {kind: paired[of_kind] for kind, of_kind in zip(PAIR_KINDS, changes.is_changed.T, strict=True)}
        for name, classes in found.items():
            self._counts[name] += np.bincount(classes, minlength=len(self.class_names))
        np.maximum.at(self._largest, paired, changes.amounts)

    @property
    def not_allowed_percent(self) -> float:
        """Share of the objects that differ in what is not allowed to; 0 without objects."""
        return self._of(np.ones(len(self.class_names), np.bool_))["not_allowed_percent"] or 0.0

    def figures(self) -> dict[str, dict[str, Any]]:
        """Figures by class, those that occur, and of `all`."""
        occurs = (self._counts["a"] + self._counts["b"]) > 0
        rows = {"all": np.ones(len(self.class_names), np.bool_)}
        rows |= {
            name: np.arange(len(self.class_names)) == row for row, name in enumerate(self.class_names) if occurs[row]
        }
        return {name: self._of(mask) for name, mask in rows.items()}

    def _of(self, mask: Bools) -> dict[str, Any]:
        counts = {name: int(count[mask].sum()) for name, count in self._counts.items()}
        objects = counts["equal"] + counts["different"]  # those of both counted once
        percent = {
            f"{name}_percent": 100 * counts[name] / objects if objects else None
            for name in ("different", "not_allowed")
        }
        largest = {
            "_".join(filter(None, ("largest", kind, unit))): (
                float(self._largest[mask, PAIR_KINDS.index(kind)].max(initial=0.0)) if counts["both"] else None
            )
            for kind, unit in self._units.items()
        }
        kinds = {str(kind): counts.pop(kind) for kind in KINDS}
        return {**counts, **percent, **kinds, **largest}
