"""What differs between two results, drawn in 3D: foxglove_msgs/SceneUpdate."""

from collections.abc import Iterator, Sequence
from typing import Any

from pipeline.core.detections import Boxes3D
from pipeline.core.ros.messages import ROS2
from pipeline.evaluation.comparison.objects import SourceObjects
from pipeline.evaluation.comparison.records import PAIR_KINDS, Changes
from writers.messages.detections import box_poses
from writers.messages.scene import LABEL_SHARE, label, outline, scene_entity, whole_scene
from writers.palette import CHANGED, EQUAL, LOST, NEW, Rgb

__all__ = ["compared_scene", "empty_scene"]

_BOLD_PX, _FINE_PX = 3.0, 1.0


def compared_scene(
    first: SourceObjects, second: SourceObjects, changes: Changes, class_names: Sequence[str], *, stamp_ns: int
) -> Any:
    """The objects of a source in one frame of two results, in the colours of what became of them.

    Lost ones are drawn where A has them, new ones where B does, others where B does with what differs beside them, and
    with a fine outline where A has them; what is equal is fine and grey.
    """
    stamp, scene = ROS2.time(stamp_ns), _Scene(class_names, ROS2.time(stamp_ns))
    changed = changes.is_changed.any(1)
    a, b = first.found.boxes, second.found.boxes
    entities = [
        *scene.boxes("equal", b, second.classes, changes.second[~changed], EQUAL, _FINE_PX),
        *scene.boxes("before", a, first.classes, changes.first[changed], CHANGED, _FINE_PX),
        *scene.boxes("lost", a, first.classes, changes.lost, LOST, _BOLD_PX, ["lost"] * len(changes.lost)),
        *scene.boxes("new", b, second.classes, changes.new, NEW, _BOLD_PX, ["new"] * len(changes.new)),
        *scene.boxes("changed", b, second.classes, changes.second[changed], CHANGED, _BOLD_PX, _texts(changes)),
    ]
    return whole_scene(stamp, entities)


def empty_scene(stamp_ns: int) -> Any:
    """Nothing, in place of what was drawn before."""
    return whole_scene(ROS2.time(stamp_ns), [])


def _texts(changes: Changes) -> list[str]:
    """What differs, of each object that both have and that differs."""
    return [
        ", ".join(kind for kind, is_changed in zip(PAIR_KINDS, row, strict=True) if is_changed)
        for row in changes.is_changed.tolist()
        if any(row)
    ]


class _Scene:
    def __init__(self, class_names: Sequence[str], stamp: Any) -> None:
        self._names, self._stamp = class_names, stamp

    def boxes(
        self,
        name: str,
        boxes: Boxes3D,
        classes: Any,
        rows: Any,
        rgb: Rgb,
        thickness_px: float,
        texts: Sequence[str] = (),
    ) -> Iterator[Any]:
        """Outlines of the boxes of some rows; `texts` beside them, if there are any."""
        chosen = boxes.select(rows)
        above = chosen.centers.copy()
        above[:, 2] += chosen.sizes[:, 2] * (0.5 + LABEL_SHARE)
        columns = zip(box_poses(chosen), chosen.sizes.tolist(), above.tolist(), classes[rows].tolist(), strict=True)
        for number, (pose, size, place, class_row) in enumerate(columns):
            class_name = self._names[class_row]
            written = [label(f"{class_name} {texts[number]}", ROS2.pose(place), rgb)] if texts else []
            metadata = {"class": class_name, "difference": texts[number] if texts else name}
            edges = [outline(pose, size, rgb, thickness_px)]
            yield scene_entity(f"{name}-{number}", self._stamp, boxes.frame_id, metadata, lines=edges, texts=written)
