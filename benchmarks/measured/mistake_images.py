"""Images of the worst errors of a result, and names for what they show."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from measured_runs import MeasuredRun
from surroundings import Surroundings

from lidcam.bags.simulator.scenario.load import load_scenario
from lidcam.outputs.report.images import MISTAKE_COLORS, cut_out
from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.readers.messages.image import decode_compressed_image
from lidcam.readers.open import open_recording
from lidcam.readers.recording import Recording
from lidcam.readers.results.result import open_result
from lidcam.readers.truth.site import SitePoses

KINDS = ("false", "missed")
TILE_PX = 208, 156
COLUMNS = 5
AROUND_NS = 200_000_000


@dataclass(frozen=True, eq=False)
class Look:
    """One of the worst errors, looked at.

    Attributes:
        kind: `false` or `missed`.
        mistake: Its figures in `lidcam evaluate`.
        name: Name of the object or thing.
        camera: The camera that shows it best; empty if none does.
        tile: (H, W, 3) uint8, what that camera saw, blue green red.
    """

    kind: str
    mistake: dict[str, Any]
    name: str
    camera: str
    tile: U8


def looks(run: MeasuredRun) -> list[Look]:
    """The worst errors of the fused objects, with a look at each."""
    scenario = load_scenario(run.scenario)
    surroundings = Surroundings(scenario)
    mistakes = [(kind, one) for kind in KINDS for one in run.figures["mistakes"]["fused"][kind]]
    found: dict[int, Look] = {}
    with open_result(run.result) as result, open_recording([run.recording]) as recording:
        poses = SitePoses([recording], result.rig, result.config)
        for row in sorted(range(len(mistakes)), key=lambda row: mistakes[row][1]["worst_ns"]):  # poses are read forward
            kind, mistake = mistakes[row]
            T_site_world = poses.T_site_frame(scenario.site_frame, mistake["worst_ns"])
            assert T_site_world is not None
            name = _name(kind, mistake, surroundings, T_site_world.inverse())
            found[row] = Look(kind, mistake, name, *_tile(kind, mistake, result.rig, recording))
    return [found[row] for row in range(len(mistakes))]


def write_images(path: Path, shown: Sequence[Look]) -> None:
    """All looks in one image: the false ones first, numbered row by row as in the tables."""
    tiles = [_numbered(look.tile, number) for number, look in enumerate(shown, 1)]
    blank = np.full_like(tiles[0], 255)
    tiles += [blank] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[first : first + COLUMNS]) for first in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 70])


def _numbered(tile: U8, number: int) -> U8:
    tile = tile.copy()
    for thickness, color in ((4, (0, 0, 0)), (1, (255, 255, 255))):
        cv2.putText(tile, str(number), (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, color, thickness, cv2.LINE_AA)
    return tile


def _name(kind: str, mistake: dict[str, Any], surroundings: Surroundings, T_world_site: Transform) -> str:
    if kind == "missed":
        return str(mistake["label"])
    label = mistake["label"]
    if label is not None:
        return {
            "class": f"the {label}, of another class",
            "second": f"a second box of the {label}",
            "place": f"the {label}, too far from its place",
        }[mistake["cause"]]
    center, size, yaw = _box(mistake)
    forward = T_world_site.matrix[:3, :3] @ np.array([np.cos(yaw), np.sin(yaw), 0.0])
    return surroundings.name(
        np.asarray(T_world_site.apply(center), np.float64), size, float(np.arctan2(forward[1], forward[0]))
    )


def _box(mistake: dict[str, Any]) -> tuple[F64, F64, float]:
    center = np.array([mistake[f"{axis}_m"] for axis in "xyz"])
    size = np.array([mistake[f"{side}_m"] for side in ("length", "width", "height")])
    return center, size, float(np.radians(mistake["yaw_deg"]))


def _tile(kind: str, mistake: dict[str, Any], rig: Rig, recording: Recording) -> tuple[str, U8]:
    """The camera that shows the place largest, and the place in its image; a grey tile if no camera does."""
    center, size, yaw = _box(mistake)
    corners = box_corners(center[None], size[None], np.array([yaw]))
    views: list[tuple[float, CameraSensor, F64]] = []
    for camera in rig.cameras:
        (box,) = camera.model.project_boxes(np.asarray(camera.T_camera_site.apply(corners), np.float64))
        area = float((box[2] - box[0]) * (box[3] - box[1]))
        if np.isfinite(area) and camera.topic:
            views.append((area, camera, box.astype(np.float64)))
    for _, camera, box in sorted(views, key=lambda view: -view[0]):
        image = _image(recording, camera, mistake["worst_ns"])
        if image is not None:
            tile = cut_out(image, box, MISTAKE_COLORS[kind], TILE_PX)
            cv2.rectangle(tile, (0, 0), (TILE_PX[0] - 1, TILE_PX[1] - 1), (255, 255, 255), 1)
            return camera.name, tile
    return "", np.full((TILE_PX[1], TILE_PX[0], 3), 160, np.uint8)


def _image(recording: Recording, camera: CameraSensor, stamp_ns: int) -> U8 | None:
    """The image of a camera nearest to a time, blue green red."""
    near: list[RawMessage] = [
        *recording.messages([camera.topic], start_ns=stamp_ns - AROUND_NS, stop_ns=stamp_ns + 2 * AROUND_NS)
    ]
    if not near:
        return None
    message = min(near, key=lambda one: (abs(one.stamp_ns - stamp_ns), one.stamp_ns))
    return cv2.cvtColor(decode_compressed_image(message).rgb, cv2.COLOR_RGB2BGR).astype(np.uint8)
