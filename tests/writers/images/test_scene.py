"""Images of frames, judged by the colours of pixels where OpenCV projects what must be there."""

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest
from frames import CONFIG, RIG, frame, tracks_of
from tracked_frames import Seen, tracked_frame

from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.frame import FrameResult, Missing
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.image import decode_any_image
from lidcam.writers.images.above import SiteMap, area_of
from lidcam.writers.images.scene import SIZE_PX, Drawn, Scenes
from lidcam.writers.palette import CAMERA_ONLY, MATCHED, Rgb, class_color


def drawn(result: FrameResult, rig: Rig = RIG, camera: str = "", config: Config = CONFIG) -> Drawn:
    scenes = Scenes(rig, config, decode_any_image)
    scene = scenes.add_frame(result)
    return scenes.camera(scene, camera) if camera else scenes.all_cameras(scene)


def corners_of(result: FrameResult) -> F64:
    objects = result.fused.objects
    return box_corners(objects.centers, objects.sizes, objects.yaws)


def has_color(image: U8, places: F64, color: Rgb) -> bool:
    """Whether within a pixel of all places (N, 2) there is the colour, nearly."""
    for x, y in np.floor(places).astype(int).tolist():
        around = image[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].reshape(-1, 3).astype(int)
        if np.abs(around - color.bytes_rgb).max(1).min() > 40:
            return False
    return True


def projected(points: F64, model: CameraModel, T_camera_site: F64) -> F64:
    rotation, _ = cv2.Rodrigues(T_camera_site[:3, :3])
    distortion = np.zeros(5)
    distortion[: len(model.distortion)] = model.distortion
    pixels, _ = cv2.projectPoints(points, rotation, T_camera_site[:3, 3], model.K, distortion)
    return np.asarray(pixels[:, 0] + 0.5, np.float64)


def test_boxes_lie_where_the_lens_has_them() -> None:
    result = frame()
    image, drops = drawn(result, camera="left")
    assert (image.shape, str(image.dtype), len(drops)) == ((480, 640, 3), "uint8", 0)
    assert has_color(image, np.array([[200.5, 240], [250, 150], [300.25, 200], [220, 250]]), MATCHED)
    assert has_color(image, np.array([[10, 50], [20, 60], [30, 50.0]]), CAMERA_ONLY)
    corners, size = corners_of(result)[0], result.fused.objects.sizes[0]
    edges = [[a, b] for a, b in combinations(corners, 2) if np.isclose(np.linalg.norm(a - b), size, atol=1e-6).any()]
    middles = np.mean(edges, 1)
    camera = RIG.cameras[0]
    places = projected(middles, camera.model, camera.T_camera_site.matrix)
    hidden = ((places > [196, 146]) & (places < [305, 255])).all(1)  # near the 2D box, which is on top
    assert len(edges) == 12
    assert (~hidden).sum() > 4
    assert has_color(image, places[~hidden], class_color(0))


@pytest.mark.parametrize("objects", [0, 1, 3])
def test_all_cameras_beside_the_site(objects: int) -> None:
    result = frame(objects=objects)
    image, drops = drawn(result)
    assert image.shape == (SIZE_PX[1], SIZE_PX[0], 3)
    assert [(drop.topic, drop.reason) for drop in drops] == [("/right/image", "the image cannot be shown")]
    assert drops[0].stamp_ns == result.bundle.messages["/right/image"].stamp_ns


def test_the_site_alone_without_cameras() -> None:
    result = replace(tracked_frame(0, Seen(7, 5, 3, 2.0), Seen(8, -9, 2)), views={})
    rig = replace(RIG, cameras=())
    image, _ = drawn(result, rig)
    area = area_of(result, rig)
    assert area is not None
    outline = corners_of(result)[:, :4]
    places = SiteMap(area, SIZE_PX[0], SIZE_PX[1] - 40).pixels(outline).reshape(-1, 2) + np.array([0, 40])
    assert has_color(image, places, class_color(0))
    clouds = {name: getattr(result.combined, name) for name in ("cloud", "ground_cloud")}
    small = {name: replace(one, xyz=one.xyz * np.float32(0.2)) for name, one in clouds.items()}
    far = replace(tracked_frame(0, Seen(7, 8, 0, 2.0)), views={})  # beyond most points: it is in view as a whole
    far = replace(far, combined=replace(result.combined, **small))
    area = area_of(far, rig)
    assert area is not None
    assert (np.abs((corners_of(far)[..., :2] - area.middle) @ area.axes.T) <= area.half_m).all()
    none = result.combined.cloud.select(np.zeros(0, np.intp))
    combined = replace(result.combined, cloud=none, ground_cloud=none)
    nothing = replace(result, combined=combined)
    assert area_of(replace(nothing, fused=tracked_frame(0).fused), rig) is None
    assert drawn(nothing, rig)[0].shape == image.shape


def test_a_slow_camera_keeps_its_image_and_a_silent_one_does_not() -> None:
    scenes, first, later = Scenes(RIG, CONFIG, decode_any_image), frame(0), frame(1)
    scenes.add_frame(first)
    messages = {topic: one for topic, one in later.bundle.messages.items() if not topic.endswith("image")}
    missing = {"/left/image": Missing.NOT_NEAR, "/right/image": Missing.SILENT}
    bundle = replace(later.bundle, messages=messages, missing=missing)
    scene = scenes.add_frame(replace(later, bundle=bundle, detections=replace(later.detections, cameras={})))
    assert dict(scene.images) == {"left": first}
    now, _ = scenes.camera(scene, "left")
    before, _ = drawn(first, camera="left")
    assert (now[30:] == before[30:]).all()
    assert (now[:30] != before[:30]).any()  # its title says how old it is
    assert (scenes.camera(scene, "right")[0][:200, :200].reshape(-1, 3).max(0) < 255).all()


def test_a_camera_that_is_not_there() -> None:
    with pytest.raises(ConfigError, match="camera: expected one of left, right, found 'front'"):
        drawn(frame(), camera="front")


def test_names_in_any_script() -> None:
    result = frame(objects=2, tracks=tracks_of([1, 0]))
    car = CONFIG.classes[0].model_copy(update={"name": "\u6c7d\u8f66"})
    named = CONFIG.model_copy(update={"classes": (car, *CONFIG.classes[1:])})
    assert (drawn(result, config=named)[0] != drawn(result)[0]).any()
