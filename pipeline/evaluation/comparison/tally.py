"""How many objects of a channel differ, by class."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from pipeline.core.arrays import I64, Bools, Indices
from pipeline.evaluation.comparison.records import KINDS, PAIR_KINDS, Changes, Kind

__all__ = ["Tally"]

_AMOUNTS = {"moved": "m", "turned": "deg", "resized": "m", "rescored": ""}
"""Unit of what is measured, by kind."""


class Tally:
    """Counts the objects of one channel.

    Args:
        class_names: Of both results.
        allowed: Kinds of differences that may be.
        unit: Of `moved`: `m` or `px`.
    """

    def __init__(self, class_names: Sequence[str], allowed: Collection[Kind], unit: str) -> None:
        self._names, self._unit = tuple(class_names), unit
        n = len(self._names)
        self._is_allowed = np.array([kind in allowed for kind in KINDS])
        self._counts = {name: np.zeros(n, np.int64) for name in ("a", "b", "both", "equal", "different", "not_allowed")}
        self._kinds = np.zeros((n, len(KINDS)), np.int64)
        self._most = np.zeros((n, len(PAIR_KINDS)))

    def add(self, changes: Changes, first_classes: Indices, second_classes: Indices) -> None:
        """Take in a frame.

        Args:
            changes: Of the frame.
            first_classes: Class of each object of A, as a row of the names; an object that both have counts with it.
            second_classes: Of B.
        """
        paired, lost, new = first_classes[changes.first], first_classes[changes.lost], second_classes[changes.new]
        forbidden = (changes.is_changed & ~self._is_allowed[2:]).any(1)
        changed = changes.is_changed.any(1)
        self._count("a", first_classes)
        self._count("b", second_classes)
        self._count("both", paired)
        self._count("equal", paired[~changed])
        self._count("different", np.concatenate([paired[changed], lost, new]))
        alone = [rows for rows, is_allowed in zip((lost, new), self._is_allowed, strict=False) if not is_allowed]
        self._count("not_allowed", np.concatenate([paired[forbidden], *alone]))
        self._kinds[:, 0] += self._by_class(lost)
        self._kinds[:, 1] += self._by_class(new)
        np.add.at(self._kinds[:, 2:], paired, changes.is_changed)
        np.maximum.at(self._most, paired, changes.amounts)

    @property
    def not_allowed_percent(self) -> float:
        """Share of the objects that differ in what is not allowed to."""
        objects = self._objects(np.ones(len(self._names), np.bool_))
        return 100 * float(self._counts["not_allowed"].sum()) / max(objects, 1)

    def figures(self) -> dict[str, dict[str, Any]]:
        """Figures by class, those that occur, and of `all`."""
        occurs = (self._counts["a"] + self._counts["b"]) > 0
        rows = {"all": np.ones(len(self._names), np.bool_)}
        rows |= {name: np.arange(len(self._names)) == row for row, name in enumerate(self._names) if occurs[row]}
        return {name: self._of(mask) for name, mask in rows.items()}

    def _count(self, name: str, classes: Indices) -> None:
        self._counts[name] += self._by_class(classes)

    def _by_class(self, classes: Indices) -> I64:
        return np.bincount(classes, minlength=len(self._names)).astype(np.int64)

    def _objects(self, mask: Bools) -> int:
        """Objects, those of both counted once."""
        return int(sum(self._counts[name][mask].sum() for name in ("equal", "different")))

    def _of(self, mask: Bools) -> dict[str, Any]:
        counts = {name: int(count[mask].sum()) for name, count in self._counts.items()}
        objects = self._objects(mask)
        percent = {
            f"{name}_percent": 100 * counts[name] / objects if objects else None
            for name in ("different", "not_allowed")
        }
        kinds = {kind: int(self._kinds[mask, row].sum()) for row, kind in enumerate(KINDS)}
        most = self._most[mask].max(0, initial=0.0)
        largest = {}
        for row, kind in enumerate(PAIR_KINDS):
            if kind in _AMOUNTS and not (self._unit == "px" and kind in {"turned", "resized"}):
                unit = self._unit if kind == "moved" else _AMOUNTS[kind]
                largest["_".join(filter(None, ("largest", kind, unit)))] = float(most[row]) if counts["both"] else None
        return counts | percent | kinds | largest
