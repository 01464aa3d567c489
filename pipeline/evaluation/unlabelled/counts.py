"""How many objects there are, of which class, how far away, in which zone, and when."""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.rig import Zone
from pipeline.core.settings.config import Config
from pipeline.evaluation.records import Figures
from pipeline.evaluation.scales import range_edges_m, range_names, range_rows

__all__ = ["ObjectCounts"]

MAX_BINS = 60
"""Into so many parts of equal time a recording is divided at most."""


class ObjectCounts:
    """Objects of one source in each frame.

    Args:
        config: Classes and ranges.
        zones: An object belongs to the first that contains its centre.
    """

    def __init__(self, config: Config, zones: Sequence[Zone]) -> None:
        self._edges_m = range_edges_m(config)
        self._classes, self._zones = config.class_names, tuple(zones)
        self._stamps_ns: list[int] = []
        self._rows: list[I64] = []

    def add(self, stamp_ns: int, boxes: Boxes3D) -> None:
        """Count the objects of one frame."""
        zones = first_polygon_with([zone.polygon_site for zone in self._zones], boxes.centers[:, :2])
        ranges = range_rows(boxes.centers, self._edges_m)
        self._stamps_ns.append(stamp_ns)
        self._rows.append(
            np.concatenate(
                [
                    [len(boxes)],
                    np.bincount(boxes.class_ids, minlength=len(self._classes)),
                    np.bincount(ranges[ranges >= 0], minlength=len(self._edges_m)),
                    np.bincount(zones[zones >= 0], minlength=len(self._zones)),
                ]
            ).astype(np.int64)
        )

    def figures(self) -> Figures:
        """Objects a frame: in all, by class, by range, by zone, and over time."""
        names = [zone.name for zone in self._zones]
        table = np.stack(self._rows)
        objects, by_class, by_range, by_zone = np.split(
            table, np.cumsum([1, len(self._classes), len(self._edges_m)]), axis=1
        )
        return {
            "frames": len(table),
            **_mean_max(objects[:, 0]),
            "classes": {name: _mean_max(column) for name, column in zip(self._classes, by_class.T, strict=True)},
            "ranges": {
                name: _mean_max(column) for name, column in zip(range_names(self._edges_m), by_range.T, strict=True)
            },
            "zones": {name: _mean_max(column) for name, column in zip(names, by_zone.T, strict=True)},
            "over_time": self._over_time(objects[:, 0], by_zone.astype(np.float64), names),
        }

    def _over_time(self, objects: I64, by_zone: F64, names: Sequence[str]) -> list[Figures]:
        """Means of parts of equal time, without parts in which no frame lies."""
        seconds = (np.array(self._stamps_ns, np.int64) - min(self._stamps_ns)) / 1e9
        bins = min(MAX_BINS, len(seconds))
        width_s = float(seconds.max()) / bins
        rows = (
            np.minimum((seconds / width_s).astype(np.int64), bins - 1) if width_s else np.zeros(len(seconds), np.int64)
        )
        return [
            {
                "from_s": row * width_s,
                "to_s": (row + 1) * width_s,
                "frames": int((rows == row).sum()),
                "per_frame_mean": float(objects[rows == row].mean()),
                "zones": dict(zip(names, by_zone[rows == row].mean(0).tolist(), strict=True)),
            }
            for row in np.unique(rows).tolist()
        ]


def _mean_max(counts: I64) -> dict[str, float | int]:
    return {"per_frame_mean": float(counts.mean()), "per_frame_max": int(counts.max())}
