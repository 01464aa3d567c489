"""Differences between two results, drawn in 3D: foxglove_msgs/SceneUpdate."""

from collections.abc import Sequence
from typing import Any

from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import UNIT_CORNERS
from lidcam.pipeline.evaluation.comparison.object_changes import PAIR_KINDS, Changes, Objects
from lidcam.writers.messages.parts import box_poses, entities, labels, opaque, outlines, whole_scene
from lidcam.writers.messages.scene import label_places
from lidcam.writers.palette import CHANGED, EQUAL, LOST, NEW, Rgb

_BOLD_PX, _FINE_PX = 3.0, 1.0


def compared_scene(
    first: Objects[Boxes3D], second: Objects[Boxes3D], changes: Changes, class_names: Sequence[str], *, stamp_ns: int
) -> Any:
    """The objects of a source in one frame of two results, in the colours of what became of them.

    Lost ones are drawn where A has them, new ones where B does, others where B does with what differs beside them, and
    with a fine outline where A has them; what is equal is fine and grey.
    """
    scene = _Scene(class_names, stamp_ns)
    changed = changes.is_changed.any(1)
    a, b = first.boxes, second.boxes
    return whole_scene(
        stamp_ns,
        scene.boxes("equal", b, second.classes, changes.second[~changed], EQUAL, _FINE_PX),
        scene.boxes("before", a, first.classes, changes.first[changed], CHANGED, _FINE_PX),
        scene.boxes("lost", a, first.classes, changes.lost, LOST, _BOLD_PX, ["lost"] * len(changes.lost)),
        scene.boxes("new", b, second.classes, changes.new, NEW, _BOLD_PX, ["new"] * len(changes.new)),
        scene.boxes("changed", b, second.classes, changes.second[changed], CHANGED, _BOLD_PX, _texts(changes)),
    )


def empty_scene(stamp_ns: int) -> Any:
    """Nothing, in place of what was drawn before."""
    return whole_scene(stamp_ns)


def _texts(changes: Changes) -> list[str]:
    """The differences of each object that both have."""
    return [
        ", ".join(kind for kind, is_changed in zip(PAIR_KINDS, row, strict=True) if is_changed)
        for row in changes.is_changed.tolist()
        if any(row)
    ]


class _Scene:
    def __init__(self, class_names: Sequence[str], stamp_ns: int) -> None:
        self._names, self._stamp_ns = class_names, stamp_ns

    def boxes(
        self,
        name: str,
        boxes: Boxes3D,
        classes: Any,
        rows: Any,
        rgb: Rgb,
        thickness_px: float,
        texts: Sequence[str] = (),
    ) -> list[Any]:
        """Outlines of the boxes of some rows; `texts` beside them, if there are any."""
        chosen, color = boxes.select(rows), opaque(rgb)
        names = [self._names[class_row] for class_row in classes[rows].tolist()]
        written = [f"{class_name} {text}" for class_name, text in zip(names, texts, strict=True)] if texts else []
        edges = outlines(UNIT_CORNERS / 2 * chosen.sizes[:, None], color, thickness_px, poses=box_poses(chosen))
        beside = labels(written, label_places(chosen)[: len(written)], color)
        return entities(
            [f"{name}-{number}" for number in range(len(chosen))],
            self._stamp_ns,
            boxes.frame_id,
            {"class": names, "difference": texts or [name] * len(chosen)},
            lines=[[edge] for edge in edges],
            texts=[[text] for text in beside] if texts else [[]] * len(chosen),
        )
