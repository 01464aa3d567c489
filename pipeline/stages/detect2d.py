"""Detection in images: from an engine's proposals to the boxes of each image."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, Indices
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.optics.upright import quarter_turns, turned
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.far_view import FarView, far_view
from lidcam.pipeline.detectors.onnx.tiles import Tile
from lidcam.pipeline.detectors.protocols import Candidates2D, Detector2D
from lidcam.pipeline.detectors.riders import PERSON, RIDDEN, finds_riders_apart, join_riders

NMS_IOU = 0.45
"""Maximum IoU of two boxes of one class; beyond it, the one with the lower score is removed."""

NMS_IOU_ANY = 0.6
"""Maximum IoU of two boxes of different classes: networks see some cars as trucks, too."""


class Detect2D:
    """Boxes of the configured classes in the images of a frame.

    Attributes:
        unknown_ids: Classes that the detector has no label of: it says nothing of their objects.
    """

    def __init__(self, rig: Rig, config: Config, detector: Detector2D) -> None:
        """Map the detector's labels to the configured classes, ignoring case; labels of no class are ignored.

        Where the detector finds a rider as a person on a bicycle, as networks trained on COCO do, each such pair
        becomes one box of the class of the latter. Raises ConfigError if none of its labels belongs to a class.
        """
        class_id_of_label = config.class_id_of_label
        labels = [label.strip().lower() for label in detector.labels]
        self._class_ids = np.array([class_id_of_label.get(label, -1) for label in labels], np.int32)
        self._joins_riders = finds_riders_apart(labels)
        self._is_person = np.array([label == PERSON for label in labels])
        self._is_ridden = np.array([label in RIDDEN for label in labels])
        if not (self._class_ids >= 0).any():
            known = [label for label in detector.labels if label]
            listed = f"{', '.join(known[:8])}{', ...' * (len(known) > 8)}"
            raise ConfigError(
                f"classes: expected labels that the 2D detector knows ({listed}), "
                f"found {', '.join(class_id_of_label)}; add them to classes.N.labels"
            )
        self.unknown_ids = frozenset(range(len(config.classes))).difference(self._class_ids.tolist())
        self._rig, self._settings = rig, config.detect2d
        people_m = [prior.size_m[2] for prior in config.classes if prior.is_upright]
        cuts = self._settings.input == "auto" and self._settings.method != "callable"  # which gets the images alone
        self._person_m = min(people_m) if people_m and cuts else None
        self._detector = detector
        self._quarters = dict.fromkeys((camera.name for camera in rig.cameras), 0)
        if self._settings.method != "callable":
            rotations = np.array([camera.T_camera_site.matrix[:3, :3] for camera in rig.cameras]).reshape(-1, 3, 3)
            self._quarters = dict(zip(self._quarters, quarter_turns(rotations).tolist(), strict=True))

    @property
    def riders(self) -> frozenset[tuple[int, int]]:
        """Classes of bicycles and of people: the box of a person may be all that is found of a rider."""
        people, ridden = (
            [class_id for class_id in self._class_ids[rows].tolist() if class_id >= 0]
            for rows in (self._is_person, self._is_ridden)
        )
        return frozenset(product(ridden, people)) if self._joins_riders else frozenset()

    def __call__(self, images: Mapping[str, Image], combined: CombinedCloud) -> Mapping[str, Boxes2D]:
        """Boxes by camera name, in the rig's order; a camera without an image in this frame has no entry.

        Boxes are in pixels of the image, clipped to it, in order of falling score. A network sees the images of cameras
        on their side or upside down turned upright, and of a large image once more the part where people are far away
        (`far_view`).

        Args:
            images: Images by camera name.
            combined: The cloud of the frame: its ground shows where in the image something is far away.

        Raises:
            ModelError: the network fails.
        """
        cameras = [camera for camera in self._rig.cameras if camera.name in images]
        upright = {camera.name: self._upright(images[camera.name], camera.name) for camera in cameras}
        views = {camera.name: view for camera in cameras if (view := self._far_view(camera, images, combined))}
        far = [view.part.cut(upright[name].rgb) for name, view in views.items()]
        found = self._detector([*(image.rgb for image in upright.values()), *far])
        proposed = {camera.name: one for camera, one in zip(cameras, found, strict=False)}
        for (name, view), one in zip(views.items(), found[len(cameras) :], strict=True):
            height_px, width_px = upright[name].rgb.shape[:2]
            proposed[name] = view.join(proposed[name], one, Tile(0, 0, width_px, height_px))
        boxes = {name: self._boxes(upright[name], one) for name, one in proposed.items()}
        for name, quarters in self._quarters.items():
            if quarters and name in boxes:
                xyxy = _turned(boxes[name].xyxy, 4 - quarters, upright[name])
                boxes[name] = replace(boxes[name], xyxy=xyxy.astype(np.float32))
        return boxes

    def _upright(self, image: Image, name: str) -> Image:
        quarters = self._quarters[name]
        return replace(image, rgb=np.ascontiguousarray(np.rot90(image.rgb, quarters))) if quarters else image

    def _far_view(self, camera: CameraSensor, images: Mapping[str, Image], combined: CombinedCloud) -> FarView | None:
        """The far part of a camera's upright image."""
        if self._person_m is None:
            return None
        level_m, max_px = self._rig.ground_height_m or 0.0, self._settings.max_input_px
        view = far_view(camera, combined, person_m=self._person_m, level_m=level_m, max_px=max_px)
        if view is None or not self._quarters[camera.name]:
            return view
        part = _turned([view.part], self._quarters[camera.name], images[camera.name])
        return view._replace(part=Tile(*part[0].astype(int).tolist()))

    def _boxes(self, image: Image, proposed: Candidates2D) -> Boxes2D:
        height, width = image.rgb.shape[:2]
        xyxy = np.clip(proposed.xyxy, 0, np.array([width, height, width, height], np.float32))
        class_ids = self._class_ids[proposed.labels]
        wanted = (proposed.scores >= self._settings.min_score) & (class_ids >= 0)
        rows = np.flatnonzero(wanted & (xyxy[:, 2] > xyxy[:, 0]) & (xyxy[:, 3] > xyxy[:, 1]))
        boxes = Boxes2D(image.stamp_ns, image.frame_id, xyxy[rows], proposed.scores[rows], class_ids[rows])
        kept = suppress_overlaps(boxes, max_iou=NMS_IOU)
        boxes, labels = boxes.select(kept), proposed.labels[rows[kept]]
        if self._joins_riders:
            boxes = join_riders(boxes, self._is_person[labels], self._is_ridden[labels])
        as_one_class = replace(boxes, class_ids=np.zeros_like(boxes.class_ids))
        return boxes.select(suppress_overlaps(as_one_class, max_iou=NMS_IOU_ANY))


def _turned(xyxy: npt.ArrayLike, quarters: int, image: Image) -> F64:
    """Boxes (N, 4) of an image that is turned."""
    boxes, (height_px, width_px) = np.asarray(xyxy, np.float64), image.rgb.shape[:2]
    return turned(boxes, np.full(len(boxes), quarters), np.tile([float(width_px), float(height_px)], (len(boxes), 1)))


def suppress_overlaps(boxes: Boxes2D, *, max_iou: float) -> Indices:
    """Greedy non-maximum suppression within each class.

    Boxes are taken in order of falling score, equal scores in the given order; each removes the boxes of its class
    whose IoU with it exceeds `max_iou`. Boxes of score 0 are removed. Returns the rows kept, in that order.
    """
    xywh = boxes.xyxy.astype(np.float64)
    xywh[:, 2:] -= xywh[:, :2]
    rows = cv2.dnn.NMSBoxesBatched(xywh.tolist(), boxes.scores.tolist(), boxes.class_ids.tolist(), 0.0, max_iou)
    return np.array(rows, np.intp)
