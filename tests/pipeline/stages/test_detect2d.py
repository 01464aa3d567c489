from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from detections import camera_rig, forward_camera, mounted
from lidar_scene import combined

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.optics.upright import turned
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.protocols import Candidates2D, Detector2D
from lidcam.pipeline.stages.detect2d import Detect2D

LABELS = ("person", "kite", "car", "bicycle", "motorcycle")
Row = tuple[float, float, float, float, float, str]
NOTHING = combined(np.zeros((0, 3)))


@dataclass
class Proposals:
    """A detector that proposes the same rows for every image."""

    rows: Sequence[Row]
    labels: tuple[str, ...] = LABELS

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        table = np.array([row[:5] for row in self.rows], np.float32).reshape(-1, 5)
        labels = np.array([self.labels.index(row[5]) for row in self.rows], np.int64)
        return [Candidates2D(table[:, :4], table[:, 4], labels) for _ in images]


def image(name: str = "cam", *, height: int = 100, width: int = 200) -> Image:
    return Image(7, f"{name}_optical", np.zeros((height, width, 3), np.uint8))


def stage_of(detector: Detector2D, config: Config | None = None, *cameras: str) -> Detect2D:
    rig, config = camera_rig(*map(forward_camera, cameras or ("cam",))), config or Config()
    return Detect2D(rig, config, detector)


def detect(rows: Sequence[Row]) -> list[tuple[list[float], float, str]]:
    config = Config()
    found = stage_of(Proposals(rows), config)({"cam": image()}, NOTHING)["cam"]
    names = [config.class_names[i] for i in found.class_ids]
    return list(zip(found.xyxy.tolist(), [round(float(s), 3) for s in found.scores], names, strict=True))


CAR: Row = (10, 10, 50, 40, 0.9, "car")
FOUND = [10, 10, 50, 40], 0.9, "car"
BICYCLE: Row = (10, 10, 50, 40, 0.6, "bicycle")
MOTORCYCLE: Row = (10, 10, 50, 40, 0.7, "motorcycle")
BEHIND: Row = (10, 10, 33, 40, 0.6, "person")


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        pytest.param([], [], id="none"),
        pytest.param([CAR], [FOUND], id="one"),
        pytest.param([(10, 10, 50, 40, 0.14, "car")], [], id="below the least score"),
        pytest.param([(10, 10, 50, 40, 0.5, "car")], [([10, 10, 50, 40], 0.5, "car")], id="another score"),
        pytest.param([(10, 10, 50, 40, 0.9, "kite")], [], id="a label of no class"),
        pytest.param([MOTORCYCLE], [([10, 10, 50, 40], 0.7, "bicycle")], id="a second label of a class"),
        pytest.param([(-20, -5, 30, 130, 0.9, "car")], [([0, 0, 30, 100], 0.9, "car")], id="beyond the image: clipped"),
        pytest.param([(210, 10, 250, 40, 0.9, "car"), (-9, 10, 0, 40, 0.9, "car")], [], id="outside of it: gone"),
        pytest.param([(20, 10, 20, 40, 0.9, "car"), (30, 10, 20, 40, 0.9, "car")], [], id="empty or inverted: gone"),
        pytest.param([(11, 10, 50, 40, 0.6, "car"), CAR], [FOUND], id="two on one car: the better one"),
        pytest.param([(11, 10, 50, 40, 0.6, "person"), CAR], [FOUND], id="two classes on one place: the better one"),
        pytest.param([BEHIND, CAR], [FOUND, ([10, 10, 33, 40], 0.6, "pedestrian")], id="one behind the other: both"),
        pytest.param([BICYCLE, MOTORCYCLE], [([10, 10, 50, 40], 0.7, "bicycle")], id="two labels: the better one"),
        pytest.param([CAR, (0, 50, 9, 60, 0.95, "car")], [([0, 50, 9, 60], 0.95, "car"), FOUND], id="falling score"),
    ],
)
def test_proposals_to_boxes(rows: list[Row], expected: list[tuple[list[float], float, str]]) -> None:
    assert detect(rows) == expected


def test_who_may_be_a_rider() -> None:
    person, bicycle = (Config().class_names.index(name) for name in ("pedestrian", "bicycle"))
    assert stage_of(Proposals([])).riders == {(bicycle, person)}
    assert not stage_of(Proposals([], ("person", "bicycle", "cyclist"))).riders


def test_what_a_detector_has_no_name_for() -> None:
    unknown = stage_of(Proposals([], ("Person", "cyclist", "kite"))).unknown_ids
    assert [Config().class_names[row] for row in sorted(unknown)] == ["car", "truck", "bus"]


def test_a_rider_and_the_bicycle_are_one() -> None:
    rows: list[Row] = [(20, 10, 40, 60, 0.8, "person"), (10, 40, 50, 70, 0.6, "bicycle"), CAR]
    assert detect(rows) == [FOUND, ([10, 10, 50, 70], 0.8, "bicycle")]


def test_networks_that_know_cyclists_are_believed() -> None:
    rows: list[Row] = [(20, 10, 40, 60, 0.8, "person"), (10, 40, 50, 70, 0.6, "bicycle")]
    assert len(stage_of(Proposals(rows, ("person", "bicycle", "cyclist")))({"cam": image()}, NOTHING)["cam"]) == 2


def test_equal_scores_keep_the_order_of_the_network() -> None:
    rows: list[Row] = [(x, 10, x + 20, 40, 0.5, "car") for x in (100, 0, 50)]
    assert [xyxy[0] for xyxy, _, _ in detect(rows)] == [100, 0, 50]


def test_cameras_in_the_order_of_the_rig_and_none_without_an_image() -> None:
    stage = stage_of(Proposals([CAR]), None, "a", "b", "c")
    assert stage({}, NOTHING) == {}
    found = stage({"c": image("c"), "a": image("a", width=30)}, NOTHING)
    assert [*found] == ["a", "c"]
    assert (found["c"].stamp_ns, found["c"].frame_id) == (7, "c_optical")
    assert found["a"].xyxy.tolist() == [[10, 10, 30, 40]], "clipped to its own image"


def test_the_far_part_of_a_large_image_is_shown_once_more() -> None:
    """The detector finds a person in whatever it is shown: of the part, it stands where the part lies."""
    person: Row = (110, 110, 120, 140, 0.9, "person")
    size_px = 2000, 1600
    rig = camera_rig(forward_camera("far", size_px=size_px), forward_camera("near"))
    images = {"far": image("far", width=2000, height=1600), "near": image("near", width=640, height=480)}
    for settings, expected in ((Detect2DConfig(), 2), (Detect2DConfig(input=(640, 640)), 1)):
        config = Config(detect2d=settings)
        found = Detect2D(rig, config, Proposals([person]))(images, NOTHING)
        assert [len(boxes) for boxes in found.values()] == [expected, 1]
    (left, top, right, bottom), (_, lower, *_) = Detect2D(rig, Config(), Proposals([person]))(images, NOTHING)[
        "far"
    ].xyxy
    assert [left, top, right, bottom] == [110, 110, 120, 140]
    assert 600 < lower < 800 + 110


@dataclass
class Brightest:
    """A detector that finds what is white, as a car if it is wider than high."""

    labels: tuple[str, ...] = LABELS

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        found = []
        for rgb in images:
            rows, columns = np.nonzero(rgb[..., 0])
            box = np.array([[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]], np.float32)
            is_car = box[0, 2] - box[0, 0] > box[0, 3] - box[0, 1]
            found.append(Candidates2D(box, np.ones(1, np.float32), np.array([2 if is_car else 1])))
        return found


@pytest.mark.parametrize("quarters", range(4))
def test_networks_see_the_images_of_turned_cameras_upright(quarters: int) -> None:
    upright = np.zeros((100, 200, 3), np.uint8)
    upright[40:60, 30:80] = 255
    rgb = np.ascontiguousarray(np.rot90(upright, -quarters))
    rows, columns = np.nonzero(rgb[..., 0])
    stage = Detect2D(camera_rig(mounted(forward_camera(), quarters)), Config(), Brightest())
    found = stage({"cam": Image(7, "cam_optical", rgb)}, NOTHING)["cam"]
    assert found.class_ids.tolist() == [0]
    assert found.xyxy.tolist() == [[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]]


@pytest.mark.parametrize("quarters", range(4))
def test_the_far_part_of_a_turned_image_is_that_of_the_upright_one(quarters: int) -> None:
    person: Row = (110, 110, 120, 140, 0.9, "person")
    camera = forward_camera(size_px=(2000, 1600))
    upright = Detect2D(camera_rig(camera), Config(), Proposals([person]))
    (expected,) = upright({"cam": image(width=2000, height=1600)}, NOTHING).values()
    width_px, height_px = (1600, 2000) if quarters % 2 else (2000, 1600)
    stage = Detect2D(camera_rig(mounted(camera, quarters)), Config(), Proposals([person]))
    (found,) = stage({"cam": image(width=width_px, height=height_px)}, NOTHING).values()
    size_px = np.tile([float(width_px), float(height_px)], (len(found), 1))
    back = turned(found.xyxy.astype(np.float64), np.full(len(found), quarters), size_px)
    np.testing.assert_allclose(back, expected.xyxy, atol=40)  # the part ends at multiples of 32 px
    assert len(found) == 2


def test_classes_that_the_detector_cannot_find_are_an_error() -> None:
    config = Config(classes=(ClassPrior(name="tram", size_m=(30, 3, 4), max_size_m=(60, 4, 5)),))
    with pytest.raises(ConfigError, match=r"person, kite, car.*found tram"):
        stage_of(Proposals([]), config)
