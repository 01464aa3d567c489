"""What a 2D network finds in the labelled pictures of KITTI, by the size of the picture that it is given.

    python benchmarks/networks.py [--model ../shared/weights/yolox_nano.onnx] [--shared ../shared]

Found: a label that a box of any class overlaps with an IoU of 0.5. False: a box that overlaps nothing labelled, not
even roughly. Of pictures without labels, that of one drive: how many of the boxes that the same network finds in
pictures of full size, with a score of 0.5 or more, it finds in smaller ones, by their height; that says what size
loses, and nothing of what is true. Milliseconds are processor time a picture on one core, all of the detector and its
suppression counted.
"""

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import cv2
import numpy as np

from pipeline.core.arrays import F64, U8
from pipeline.core.camera import CameraModel
from pipeline.core.detections import Boxes2D
from pipeline.core.errors import ModelError
from pipeline.core.geometry.boxes import iou_xyxy
from pipeline.core.geometry.transform import Transform
from pipeline.core.images import Image
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.settings.config import Config
from pipeline.core.settings.detect import Detect2DConfig
from pipeline.detectors.onnx import session
from pipeline.detectors.onnx.detector import OnnxDetector2D
from pipeline.stages.detect2d import Detect2D

CARS = frozenset({"Car", "Van"})
NEUTRAL = "DontCare"
RANGES_M = (10.0, 20.0, 40.0, 80.0)
HEIGHTS_PX = (30, 60)
MIN_IOU, ROUGHLY = 0.5, 0.2
SURE = 0.5
FULL_PX = 1248 * 384
"""KITTI's pictures, to whole strides."""

SIZES: dict[str, dict[str, Any]] = {
    "416 x 416, all of the picture": {"input": (416, 416)},
    "640 x 224": {"max_input_px": 640 * 224},
    "768 x 224": {"max_input_px": 416 * 416},
    "960 x 320 (default)": {},
    "1152 x 352": {"max_input_px": 640 * 640},
    "1248 x 384": {"max_input_px": FULL_PX},
}
TILED: dict[str, dict[str, Any]] = {
    "416 x 416, 2 tiles": {},
    "416 x 416, 3 tiles": {"max_input_px": 3 * 416**2},
}
"""What a network is given that takes one size only."""


class Labelled(NamedTuple):
    """A picture and what is labelled in it.

    Attributes:
        rgb: (H, W, 3).
        kinds: KITTI's name of each object.
        depths_m: (N,) distance along the camera's axis.
        xyxy: (N, 4) pixels.
    """

    rgb: U8
    kinds: Sequence[str]
    depths_m: F64
    xyxy: F64


def picture(path: Path) -> U8:
    """A picture, red first."""
    bgr = cv2.imread(str(path))
    if bgr is None:
        raise SystemExit(f"{path}: no picture")
    return np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)


def labelled_pictures(data: Path) -> list[Labelled]:
    """The labelled pictures of KITTI's object benchmark that lie there."""
    found = []
    for path in sorted((data / "kitti_object/training/image_2").glob("*.png")):
        lines = (path.parents[1] / "label_2" / f"{path.stem}.txt").read_text().splitlines()
        rows = [line.split() for line in lines]
        boxes = np.array([row[4:8] for row in rows], np.float64)
        found.append(Labelled(picture(path), [row[0] for row in rows], np.array([float(r[13]) for r in rows]), boxes))
    folder = data / "kitti_object_8"
    kinds = {-1: NEUTRAL, 0: "Pedestrian", 1: "Cyclist", 2: "Car"}
    for sample in json.loads((folder / "info_from_pkl.json").read_text())["data_list"]:
        objects = sample["instances"]
        found.append(
            Labelled(
                picture(folder / sample["images"]["CAM2"]["img_path"]),
                [kinds[one["bbox_label"]] for one in objects],
                np.array([one["depth"] for one in objects]),
                np.array([one["bbox"] for one in objects]),
            )
        )
    return found


class Judged:
    """A network, given pictures of one size."""

    def __init__(self, model: Path, **settings: Any) -> None:
        config = Config(detect2d=Detect2DConfig.model_validate(settings))
        intrinsics = CameraModel("cam", 1242, 375, np.diag([700.0, 700.0, 1.0]), "plumb_bob", np.zeros(0))
        camera = CameraSensor("cam", "/cam", "", intrinsics, Transform.identity("cam", "site"))
        self._stage = Detect2D(
            Rig("site", (), (camera,), ()),
            config.class_id_of_label,
            config.detect2d,
            OnnxDetector2D(model, config.detect2d),
        )
        self._seconds = 0.0
        self._pictures = 0

    def boxes(self, rgb: U8) -> Boxes2D:
        """The boxes in a picture."""
        started = time.process_time()
        found = self._stage({"cam": Image(0, "cam", rgb)})["cam"]
        self._seconds += time.process_time() - started
        self._pictures += 1
        return found

    @property
    def milliseconds(self) -> float:
        """Processor time a picture."""
        return self._seconds / self._pictures * 1e3


def refuse(data: bytes, input_name: str) -> bytes:
    """In place of `free_size`, as if the network held a table for its size."""
    raise ModelError(f"{input_name} in {len(data)} bytes stays as it is")


def overlaps(first: F64, second: F64) -> F64:
    """IoU (N, M), with a column of zeros after them."""
    return np.concatenate([iou_xyxy(first, second), np.zeros((len(first), 1))], 1)


def row_of(judged: Judged, labelled: Sequence[Labelled], drive: Sequence[tuple[U8, Boxes2D]]) -> list[str]:
    """The figures of one size."""
    there: Counter[str] = Counter()
    found: Counter[str] = Counter()
    false = 0
    for one in labelled:
        boxes = judged.boxes(one.rgb)
        hit = overlaps(one.xyxy, boxes.xyxy.astype(np.float64)).max(1) >= MIN_IOU
        for kind, depth_m, is_found in zip(one.kinds, one.depths_m.tolist(), hit.tolist(), strict=True):
            column = column_of(kind, depth_m)
            there[column] += 1
            found[column] += is_found
        false += int((overlaps(boxes.xyxy.astype(np.float64), one.xyxy).max(1) < ROUGHLY).sum())
    kept: Counter[int] = Counter()
    sure: Counter[int] = Counter()
    for rgb, reference in drive:
        boxes = judged.boxes(rgb)
        same = iou_xyxy(reference.xyxy, boxes.xyxy) * (reference.class_ids[:, None] == boxes.class_ids)
        again = np.concatenate([same, np.zeros((len(reference), 1))], 1).max(1) >= MIN_IOU
        height = np.digitize(reference.xyxy[:, 3] - reference.xyxy[:, 1], HEIGHTS_PX).tolist()
        sure.update(height)
        kept.update(row for row, is_kept in zip(height, again.tolist(), strict=True) if is_kept)
    cells = [f"{found[column]} of {there[column]}" if there[column] else "" for column in COLUMNS]
    again_cells = [f"{kept[row]} of {sure[row]}" if sure[row] else "" for row in range(len(HEIGHTS_PX) + 1)]
    return [*cells, str(false), *again_cells, f"{judged.milliseconds:.0f}"]


def column_of(kind: str, depth_m: float) -> str:
    """Which figure an object counts for."""
    if kind == NEUTRAL:
        return ""
    if kind not in CARS:
        return "others"
    return f"cars to {next((m for m in RANGES_M if depth_m < m), RANGES_M[-1]):g} m"


COLUMNS = (*(f"cars to {m:g} m" for m in RANGES_M), "others")


def main() -> None:
    """Print a table with a row for each size."""
    shared = Path(__file__).resolve().parents[2] / "shared"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, default=shared / "weights/yolox_nano.onnx")
    parser.add_argument("--shared", type=Path, default=shared)
    arguments = parser.parse_args()
    if not arguments.model.is_file() or not (arguments.shared / "data").is_dir():
        print(f"{arguments.model}, {arguments.shared / 'data'}: not at hand, so nothing is measured")
        return
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

    labelled = labelled_pictures(arguments.shared / "data")
    full = Judged(arguments.model, max_input_px=FULL_PX, min_score=SURE)
    pictures = map(picture, sorted((arguments.shared / "data/kitti_raw_sequence").rglob("*.png")))
    drive = [(rgb, full.boxes(rgb)) for rgb in pictures]
    heights = ("under 30 px", "30 to 60 px", "over 60 px")
    print("| picture given |", " | ".join((*COLUMNS, "false", *heights, "ms")), "|")
    print("| --- " * (len(COLUMNS) + len(heights) + 3) + "|")
    for name, settings in SIZES.items():
        print(f"| {name} |", " | ".join(row_of(Judged(arguments.model, **settings), labelled, drive)), "|")
    with patch.object(session, "free_size", refuse):
        for name, settings in TILED.items():
            print(f"| {name} |", " | ".join(row_of(Judged(arguments.model, **settings), labelled, drive)), "|")


if __name__ == "__main__":
    main()
