"""The formats of data sets, on frames made by hand; KITTI's are read back by the reader of truth."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion, matrix_of_rpy, pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.truth.kitti import KittiTruth, parse_kitti_labels
from lidcam.writers.datasets.cvat import CvatWriter
from lidcam.writers.datasets.frame import (
    DatasetBoxes,
    DatasetFrame,
    DatasetImage,
    DatasetScene,
    DatasetWriter,
    undistorted,
)
from lidcam.writers.datasets.kitti import KittiTrackingWriter, KittiWriter
from lidcam.writers.datasets.nuscenes import VERSION, NuScenesWriter

STAMP_NS = 1_700_000_000_123_456_789
K = np.array([[300.0, 0, 320], [0, 300, 240], [0, 0, 1]])


# A lidar that is tilted, and a camera beside it that looks ahead, 25 degrees down and a little to the side.
T_SITE_LIDAR = pose_matrix(matrix_of_rpy((0.02, -0.1, 0.4)), (0.3, -0.2, 4.0))
T_SITE_CAMERA = pose_matrix(matrix_of_rpy((0.03, 0.44, -0.1)), (0.5, 0.1, 4.2))
T_SITE_CAMERA[:3, :3] = T_SITE_CAMERA[:3, :3] @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
MODEL = CameraModel("camera", 640, 480, K, "plumb_bob", np.zeros(5))
CAMERA = CameraSensor("front", "/image", "", MODEL, Transform("site", "camera", T_SITE_CAMERA).inverse())
RIG = Rig("site", (LidarSensor("top", "/points", Transform("site", "lidar", T_SITE_LIDAR)),), (CAMERA,), ())
SCENE = DatasetScene("drive", "drive 1", RIG, (CAMERA,), T_SITE_LIDAR, "lidar")
MANY = [  # x, y, yaw, track: ahead three times, the last without a track; behind the camera
    (8.0, 0.5, 0.3, 4),
    (12.0, -1.0, -2.9, 7),
    (20.0, 2.0, np.pi, -1),
    (-9.0, 0.0, 1.0, 2),
]


def boxes(rows: list[tuple[float, float, float, int]], name: str = "Car", score: float = 0.25) -> DatasetBoxes:
    x, y, yaws, tracks = np.array(rows, np.float64).reshape(-1, 4).T
    n = len(rows)
    return DatasetBoxes(
        np.full(n, name),
        np.column_stack([x, y, np.full(n, 0.8)]),
        np.tile([4.2, 1.8, 1.6], (n, 1)),
        yaws,
        np.full(n, score, np.float32),
        tracks.astype(np.int64),
        np.tile([2.0, np.nan], (n, 1)),
        np.full(n, -1, np.int32),
    )


def frame(found: DatasetBoxes, *, index: int = 0, truth: DatasetBoxes | None = None, T: Any = None) -> DatasetFrame:
    xyz = np.array([[8.0, 0.5, 0.9], [8.2, 0.4, 0.9], [30, 0, 0]], np.float32)
    in_lidar = ((xyz - T_SITE_LIDAR[:3, 3]) @ T_SITE_LIDAR[:3, :3]).astype(np.float32)
    intensity, ring = np.array([0, 0.5, 1], np.float32), np.array([0, 1, 2], np.uint16)
    cloud = PointCloud(STAMP_NS, "lidar", in_lidar, intensity, ring, np.zeros(3, np.int32))
    T_fixed_site = np.eye(4) if T is None else T
    stamp_ns = STAMP_NS + index * 100_000_000
    image = DatasetImage(stamp_ns + 5_000_000, np.full((480, 640, 3), 90, np.uint8), T_fixed_site)
    return DatasetFrame(index, stamp_ns, T_fixed_site, cloud, {"front": image}, found, truth)


def written(writer: DatasetWriter, *frames: DatasetFrame) -> None:
    writer.begin(SCENE)
    for one in frames:
        writer.add_frame(one)
    writer.finish()


def kitti_labels(folder: Path, name: str = "label_2/000000.txt") -> Any:
    return parse_kitti_labels((folder / "training" / name).read_text(), folder)


@pytest.mark.parametrize(("rows", "seen"), [([], 0), (MANY[:1], 1), (MANY, 3)])
def test_kitti_labels_are_read_back_though_lidar_and_camera_are_tilted(
    tmp_path: Path, rows: list[tuple[float, float, float, int]], seen: int
) -> None:
    found, writer = boxes(rows), KittiWriter(tmp_path)
    written(writer, frame(found))
    truth = KittiTruth(tmp_path / "training", RIG, Config())
    read = truth.at(STAMP_NS, frame=0)
    assert read is not None
    np.testing.assert_allclose(read.centers, found.centers[:seen], atol=1e-3)
    np.testing.assert_allclose(read.sizes, found.sizes[:seen], atol=1e-3)
    np.testing.assert_allclose(np.cos(read.yaws - found.yaws[:seen]), 1, atol=1e-6)
    in_image = truth.in_image("front", STAMP_NS, frame=0)
    assert in_image is not None  # the calibration is that of the rig's camera
    assert len(in_image.xyxy) == seen
    assert writer.left_out == ({"boxes that front does not see": 1} if len(rows) > seen else {})
    lines = (tmp_path / "results/lidcam/data/000000.txt").read_text().splitlines()
    assert [line.split()[15:] for line in lines] == [["0.250000"]] * seen


def test_kitti_has_points_in_the_frame_of_the_lidar(tmp_path: Path) -> None:
    written(KittiWriter(tmp_path), one := frame(boxes([])))
    points = np.fromfile(tmp_path / "training/velodyne/000000.bin", "<f4").reshape(-1, 4)
    assert one.cloud is not None
    np.testing.assert_array_equal(points, np.column_stack([one.cloud.xyz, one.cloud.intensity]))


def test_labels_are_the_truth_where_there_is_one(tmp_path: Path) -> None:
    written(KittiWriter(tmp_path), frame(boxes(MANY[:1]), truth=boxes(MANY[1:3], "Van")))
    assert [one.label for one in kitti_labels(tmp_path).labels] == ["Van", "Van"]
    assert (tmp_path / "results/lidcam/data/000000.txt").read_text().split()[0] == "Car"


@pytest.mark.parametrize(
    ("kind", "lacks", "reason"),
    [
        (KittiWriter, {"images": {}}, "frames without an image of front"),
        *((kind, {"cloud": None}, "frames without a cloud") for kind in (KittiWriter, NuScenesWriter, CvatWriter)),
    ],
)
def test_a_frame_without_what_a_format_needs_is_left_out(tmp_path: Path, kind: Any, lacks: Any, reason: str) -> None:
    writer = kind(tmp_path)
    written(writer, replace(frame(boxes(MANY)), **lacks))
    assert writer.left_out == {reason: 1}
    assert not [*tmp_path.rglob("0*")]


def test_kitti_tracking_numbers_frames_and_tracks(tmp_path: Path) -> None:
    writer = KittiTrackingWriter(tmp_path)
    written(writer, frame(boxes(MANY)), frame(boxes(MANY[:1]), index=3))
    labels = kitti_labels(tmp_path, "label_02/0000.txt")
    assert labels.is_tracking
    assert [(one.frame, one.track_id) for one in labels.labels] == [(0, 4), (0, 7), (1, 4)]
    assert writer.left_out == {"boxes without a track": 1, "boxes that front does not see": 1}
    assert (tmp_path / "training/evaluate_tracking.seqmap.training").read_text() == "0000 empty 000000 000002\n"


def test_kitti_boxes_in_the_image_are_those_of_its_time(tmp_path: Path) -> None:
    """An image 0.1 s after the cloud, from a rig that has driven 1 m; what stands is nearer, what goes along is not."""

    def seen(name: str, x_m: float, speed_m_s: float, *, is_late: bool) -> tuple[F64, list[str]]:
        """The box in the image, and the one in 3D."""
        one = frame(replace(boxes([(x_m, 0.5, 0.3, 4)]), velocities=np.array([[speed_m_s, 0.0]])))
        moved = pose_matrix(np.eye(3), (1, 0, 0))
        image = replace(one.images["front"], stamp_ns=one.stamp_ns + 100_000_000, T_fixed_site=moved)
        written(KittiWriter(tmp_path / name), replace(one, images={"front": image}) if is_late else one)
        (line,) = (tmp_path / name / "training/label_2/000000.txt").read_text().splitlines()
        return np.array(line.split()[4:8], float), line.split()[8:]

    now, stands = seen("now", 8.0, 0.0, is_late=False), seen("stands", 8.0, 0.0, is_late=True)
    along, nearer = seen("along", 8.0, 10.0, is_late=True), seen("nearer", 7.0, 0.0, is_late=False)
    np.testing.assert_allclose(stands[0], nearer[0], atol=0.02)
    np.testing.assert_allclose(along[0], now[0], atol=0.5)
    assert now[1] == stands[1] == along[1], "in 3D they are where the points are"


def test_kitti_has_no_boxes_without_width(tmp_path: Path) -> None:
    """Objects that slip past the border of the image; the reader refuses boxes of no area."""
    found = boxes([(x, y, 0.0, 0) for x in (6.0, 8.0) for y in np.arange(3, 9, 0.02)])
    written(writer := KittiWriter(tmp_path), frame(found))
    labels = kitti_labels(tmp_path).labels
    assert 0 < len(labels) < len(found)
    assert min(np.ptp(np.reshape(one.xyxy, (2, 2)), axis=0).min() for one in labels) >= 1.99
    assert writer.left_out["boxes that front does not see"] == len(found) - len(labels)


def test_kitti_tracking_has_the_words_of_its_benchmark(tmp_path: Path) -> None:
    written(KittiTrackingWriter(tmp_path), frame(boxes(MANY[:1])))
    lines = (tmp_path / "training/calib/0000.txt").read_text().splitlines()
    assert [line.split()[0] for line in lines] == ["P0:", "P1:", "P2:", "P3:", "R_rect", "Tr_velo_cam", "Tr_imu_velo"]
    assert KittiTrackingWriter.names["person_sitting"] == "Person"
    assert KittiTruth(tmp_path / "training/label_02/0000.txt", RIG, Config()).at(STAMP_NS, frame=0) is not None


def test_nuscenes_refuses_two_cameras_of_one_channel(tmp_path: Path) -> None:
    twice = tuple(replace(CAMERA, name=name) for name in ("front", "CAM_front"))
    with pytest.raises(OutputError, match="two cameras would both be CAM_front"):
        NuScenesWriter(tmp_path).begin(replace(SCENE, cameras=twice))


def test_kitti_tracking_numbers_true_objects_from_0(tmp_path: Path) -> None:
    """Ids of a truth may be hashes, of which TrackEval cannot make tables."""
    truth = boxes([(8.0, 0.5, 0.3, 2**60), (12.0, -1.0, 0.0, 7)])
    written(KittiTrackingWriter(tmp_path), frame(boxes([]), truth=truth), frame(boxes([]), truth=truth, index=1))
    assert [one.track_id for one in kitti_labels(tmp_path, "label_02/0000.txt").labels] == [0, 1, 0, 1]


@pytest.mark.parametrize("make", [NuScenesWriter, KittiWriter, KittiTrackingWriter, CvatWriter])
def test_the_same_frames_give_the_same_bytes(tmp_path: Path, make: Callable[[Path], DatasetWriter]) -> None:
    contents = []
    for name in ("a", "b"):
        written(make(tmp_path / name), frame(boxes(MANY, "car")), frame(boxes([], "car"), index=1))
        files = sorted(path for path in (tmp_path / name).rglob("*") if path.is_file())
        contents.append({path.relative_to(tmp_path / name): path.read_bytes() for path in files})
    assert contents[0] == contents[1]


def test_cvats_cuboids_stand_in_its_clouds(tmp_path: Path) -> None:
    writer = CvatWriter(tmp_path)
    written(writer, frame(boxes(MANY, "car")), frame(boxes([]), truth=boxes(MANY[:1], "van"), index=3))
    header, _, data = (tmp_path / "pointcloud/drive_000000.pcd").read_bytes().partition(b"DATA binary\n")
    assert b"\nPOINTS 3\n" in header
    points = np.frombuffer(data, "<f4").reshape(3, 4)
    np.testing.assert_allclose(points, np.array([[8, 0.5, 0.9, 0], [8.2, 0.4, 0.9, 0.5], [30, 0, 0, 1]]), atol=1e-5)
    whole = json.loads((tmp_path / "annotations/default.json").read_text())
    first, second = whole["items"]
    assert (first["id"], second["id"], second["attr"]["frame"]) == ("drive_000000", "drive_000003", 1)
    in_track = {"keyframe": True, "outside": False, "occluded": False}  # without these, CVAT makes no tracks
    expected = [{"track_id": track, **in_track} if track >= 0 else {} for track in (0, 1, -1, 2)]
    assert [box["attributes"] for box in first["annotations"]] == expected
    [box] = second["annotations"]  # the truth, of the same track, but of another class
    assert (box["position"], box["scale"], box["rotation"]) == ([8.0, 0.5, 0.8], [4.2, 1.8, 1.6], [0.0, 0.0, 0.3])
    assert (box["label_id"], box["attributes"]) == (1, {"track_id": 3, **in_track})
    assert [label["name"] for label in json.loads((tmp_path / "labels.json").read_text())] == ["car", "van"]
    assert (tmp_path / "related_images/drive_000003_pcd/front.jpg").is_file()
    assert writer.written == {"frames": 2, "images": 2, "boxes": 5}


def tables_of(folder: Path) -> dict[str, list[dict[str, Any]]]:
    return {path.stem: json.loads(path.read_text()) for path in (folder / VERSION).glob("*.json")}


def test_nuscenes_tables_refer_to_one_another(tmp_path: Path) -> None:
    written(NuScenesWriter(tmp_path), *(frame(boxes(MANY[:3], "car"), index=index) for index in (0, 2)))
    tables = tables_of(tmp_path)
    known = {name: {row["token"] for row in rows} for name, rows in tables.items() if name != "splits"}
    known["annotation"] = known["sample_annotation"]
    for name, row in [(table, row) for table in known for row in tables.get(table, ())]:
        for key, value in row.items():
            table = name if key in {"prev", "next"} else re.sub(r"^(first_|last_)?(.*)_token$", r"\2", key)
            if value and table != key and table in known:
                assert value in known[table], (name, key)
    assert [row["nbr_annotations"] for row in tables["instance"]] == [2, 2, 1, 1]  # two have a track
    assert all((tmp_path / row["filename"]).is_file() for row in tables["sample_data"])
    assert {row["num_lidar_pts"] for row in tables["sample_annotation"]} == {0, 2}
    assert json.loads((tmp_path / VERSION / "splits.json").read_text()) == {"lidcam": ["drive"]}


def test_nuscenes_boxes_stand_in_the_fixed_frame(tmp_path: Path) -> None:
    T_fixed_site = pose_matrix(matrix_of_rpy((0, 0, np.pi / 2)), (100, 50, 0))
    written(NuScenesWriter(tmp_path), frame(boxes([(8, 0.5, 0.3, 4)], "car"), T=T_fixed_site))
    (row,) = tables_of(tmp_path)["sample_annotation"]
    np.testing.assert_allclose(row["translation"], [99.5, 58, 0.8])
    assert row["size"] == [1.8, 4.2, 1.6]
    w, x, y, z = row["rotation"]
    along = matrix_of_quaternion([x, y, z, w])[:3, 0]
    assert np.arctan2(along[1], along[0]) == pytest.approx(0.3 + np.pi / 2)
    (found,) = next(iter(json.loads((tmp_path / "results.json").read_text())["results"].values()))
    np.testing.assert_allclose(found["velocity"], [0, 2], atol=1e-12)
    assert (found["detection_name"], found["detection_score"]) == ("car", 0.25)


def test_a_submission_has_at_most_500_boxes_a_sample(tmp_path: Path) -> None:
    writer = NuScenesWriter(tmp_path)
    written(writer, frame(boxes([(x, 0.0, 0.0, -1) for x in range(502)], "car")))
    assert [*writer.left_out.values()] == [2]
    assert len(next(iter(json.loads((tmp_path / "results.json").read_text())["results"].values()))) == 500


def test_images_are_those_of_a_pinhole_camera() -> None:
    """A line that the lens bends is straight again."""
    model = replace(MODEL, distortion=np.array([-0.3, 0.05, 0, 0, 0]))
    straight = np.stack([np.full(400, 0.6), np.linspace(-0.6, 0.6, 400), np.ones(400)], -1)
    pixels, _ = model.project(straight)
    bent = np.zeros((480, 640, 3), np.uint8)
    columns, rows = np.floor(pixels).astype(int).T
    bent[rows, columns] = bent[rows, columns - 1] = 255
    shown = undistorted(bent, model)
    found = np.nonzero(shown[..., 0] > 100)
    assert np.ptp(columns) > 12
    assert np.abs(found[1] - 500).max() <= 3
