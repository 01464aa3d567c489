import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from builders import camera_info, header, raw, transform_stamped
from helpers import ROOT
from hypothesis import given
from hypothesis import strategies as st
from rig_messages import cloud, discover, image_message, reasons, static
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.errors import CalibrationError, ConfigError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Rig, TruthVehicle
from lidcam.readers.rig.calibration import rigid_transform
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.rig.lens import decompose_projection
from lidcam.readers.rig.rig_file import load_rig, merge_rigs, rig_yaml
from lidcam.readers.rig.schema import CameraEntry, LidarEntry, Pose, RigFile, TruthEntry, parse_rig

EYE = np.eye(4).tolist()
SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
K = [[500.0, 0.0, 32.0], [0.0, 500.0, 24.0], [0.0, 0.0, 1.0]]
# x forward to z forward: a camera at the site's origin that looks along +x
LOOK_X = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
POSED = {"K": K, "T_camera_site": LOOK_X}
CAR1 = {"topic": "/odom", "size_m": [4, 2, 1.5]}


RECORDED = [cloud("/a_points", "a"), cloud("/b_points", "b"), image_message("/cam11/image", "cam")]


def apply(tree: dict[str, Any], *more: RawMessage, **sections: Any) -> Discovery:
    return discover([*RECORDED, *more], parse_rig(tree, Path("rig.yaml")), **sections)


def assert_same(one: Rig, other: Rig) -> None:
    assert rig_yaml(one) == rig_yaml(other)
    for lidar, same in zip(one.lidars, other.lidars, strict=True):
        np.testing.assert_array_equal(lidar.T_site_lidar.matrix, same.T_site_lidar.matrix)
    for a, b in zip(one.cameras, other.cameras, strict=True):
        np.testing.assert_array_equal(a.model.K, b.model.K)
        np.testing.assert_array_equal(a.model.distortion, b.model.distortion)
        np.testing.assert_array_equal(a.T_camera_site.matrix, b.T_camera_site.matrix)


def test_a_written_rig_reads_back_to_the_same_numbers(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.1, -0.2, 1.3]).as_quat().tolist()
    lens: Any = {"width_px": 64, "height_px": 48, "distortion": (-0.1, 1e-7, 1e-17, 1e16, 0)}
    fields = camera_info(np.array(K) + 1 / 3, stamp_ns=5, frame_id="cam", **lens)
    fields = {**fields, "k": (np.array(K) * [[1 / 3, 1, 1], [1, 1 / 7, 1], [1, 1, 1]]).reshape(9)}
    edges = [
        transform_stamped("site", name, stamp_ns=5, translation=(1 / 3, -2e-9, 3), rotation_xyzw=turn)
        for name in ("a", "b", "cam")
    ]
    messages = [
        *RECORDED,
        static(*edges),
        raw("/cam11/camera_info", "sensor_msgs/msg/CameraInfo", fields, 5),
        raw("/cam11/detections", "vision_msgs/msg/Detection2DArray", {"header": header(5, "cam")}, 5),
    ]
    found = discover(messages)
    assert found.faults == ()
    (tmp_path / "rig.yaml").write_text(rig_yaml(found.rig))
    again = discover(messages, load_rig(tmp_path / "rig.yaml"))
    assert again.faults == ()
    assert again.notes == ()
    assert_same(found.rig, again.rig)
    assert {source.extrinsics for source in again.sources} == {"rig file"}


def test_zones_vehicles_and_time_offsets_are_read_and_written(tmp_path: Path) -> None:
    camera = {"topic": "/cam11/image", "K": K, "T_camera_site": EYE, "time_offset_ms": -35.5}
    lidars = {"a": {"topic": "/a_points", "T_site_lidar": EYE, "time_offset_ms": 12}, "b": {"T_site_lidar": EYE}}
    uses = {"detect": "detect", "ignore": "ignore", "count": "count"}
    zones = {"plain": SQUARE, "bare": {"corners": SQUARE}} | {n: {"corners": SQUARE, "use": u} for n, u in uses.items()}
    truth = {"car1": {**CAR1, "offset_m": [1, 0, 0.7], "class": "van"}}
    tree = {"site_frame": "s", "lidars": lidars, "cameras": {"cam": camera}, "zones": zones, "truth": truth}
    (tmp_path / "rig.yaml").write_text(rig_yaml(apply(tree).rig))
    for found in (apply(tree), discover(RECORDED, load_rig(tmp_path / "rig.yaml"))):
        assert_same(found.rig, apply(tree).rig)
        assert {zone.name: zone.use for zone in found.rig.zones} == {"plain": "count", "bare": "count"} | uses
        assert all(zone.polygon_site.tolist() == SQUARE for zone in found.rig.zones)
        assert [zone.name for zone in found.rig.counted_zones] == ["plain", "bare", "detect", "count"]
        assert found.rig.truth == {"car1": TruthVehicle("/odom", "van", (4, 2, 1.5), (1, 0, 0.7))}
        assert [source.time_offset_ms for source in found.sources] == [12, 0, -35.5]
        assert [lidar.time_offset_ns for lidar in found.rig.lidars] == [12_000_000, 0]
        assert [camera.time_offset_ns for camera in found.rig.cameras] == [-35_500_000]
    written = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    assert written["zones"]["bare"] == SQUARE
    assert "time_offset_ms" not in written["lidars"]["b"]


@pytest.mark.parametrize(
    "pose",
    [
        {"T_site_lidar": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]},
        {"T_site_lidar": [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]},
        {"translation_m": [1, 2, 3], "rotation_xyzw": [0, 0, np.sqrt(0.5), np.sqrt(0.5)]},
        {"translation_m": [1, 2, 3], "rpy_deg": [0, 0, 90]},
        {"translation_m": [1, 2, 3], "rpy_deg": [90, 0, 90]},  # about fixed axes, x first
    ],
)
def test_lidar_poses_in_every_form(pose: dict[str, Any]) -> None:
    rig = apply({"site_frame": "s", "lidars": {"x": {"topic": "/a_points", **pose}}, "cameras": {}}).rig
    np.testing.assert_allclose(rig.lidars[0].T_site_lidar.apply(np.array([1.0, 0, 0])), [1, 3, 3], atol=1e-12)
    assert rig.lidars[0].T_site_lidar.src == "a"


@pytest.mark.parametrize(
    "calibration",
    [
        {"K": K, "T_camera_site": LOOK_X},
        {"K": np.array(K).reshape(9).tolist(), "T_site_camera": np.linalg.inv(LOOK_X).tolist()},
        {"K": K, "rotation_xyzw": [-0.5, 0.5, -0.5, 0.5]},
        {"P": (np.array(K) @ np.array(LOOK_X)[:3]).tolist()},
        {"P": (7.5 * np.array(K) @ np.array(LOOK_X)[:3]).tolist()},
    ],
)
def test_camera_calibration_in_every_form(calibration: dict[str, Any]) -> None:
    tree = {
        "site_frame": "s",
        "ground_height_m": -1.7,
        "lidars": {"x": {"topic": "/a_points", "T_site_lidar": EYE}},
        "cameras": {"cam11": calibration},
        "zones": {"lane": [[0, 0], [1, 0], [1, 1]]},
    }
    found = apply(tree)
    assert found.faults == ()
    camera = found.rig.cameras[0]
    assert (camera.topic, camera.model.width_px, camera.model.frame_id) == ("/cam11/image", 64, "cam")
    np.testing.assert_allclose(camera.model.K, K, atol=1e-9)
    np.testing.assert_allclose(camera.T_camera_site.matrix, LOOK_X, atol=1e-12)
    assert found.rig.ground_height_m == -1.7
    assert [zone.name for zone in found.rig.zones] == ["lane"]


@pytest.mark.parametrize(
    ("tree", "reason"),
    [
        ({"lidars": {"a": {"T_site_lidar": EYE}}}, "site_frame is missing in the rig file: .* pose of a is given in"),
        ({"cameras": {"cam11": {"K": K, "T_camera_site": LOOK_X}}}, r"of cam11 is given in; where the lidars \(a, b\)"),
    ],
)
def test_poses_in_a_frame_without_a_name_are_refused(tree: dict[str, Any], reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        apply(tree)
    named = tree | {"site_frame": "a"}
    assert apply(named).rig.site_frame == "a"
    assert apply(tree, rig={"site_frame": "a"}).rig.site_frame == "a"


SKEWED = [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("camera", "reason"),
    [
        ({"K": K, "T_camera_site": np.diag([0, 0, 1.0, 1]).tolist()}, "of T_camera_site is not valid: it is singular"),
        ({"K": K, "T_camera_site": SKEWED}, "not orthonormal"),
        ({"K": K, "T_camera_site": np.diag([1.0, 1, -1, 1]).tolist()}, "reflection"),
        ({"K": K, "T_camera_site": np.diag([1.0, 1, 1, 2]).tolist()}, "last row"),
        ({"K": K, "rotation_xyzw": [0, 0, 0, 2]}, "length 1, found 2"),
        ({"K": np.diag([1e9, 1e9, 1]).tolist(), "T_camera_site": LOOK_X}, "focal length"),
        ({**POSED, "width_px": 640, "height_px": 480}, "64 x 48 px, but"),
        ({**POSED, "distortion_model": "odd", "distortion": [1.0]}, "'odd' with 1 coefficients"),
        ({"P": np.zeros((3, 4)).tolist()}, "singular"),
        ({"P": (np.diag([-1, 1, 1]) @ np.array(K) @ np.array(LOOK_X)[:3]).tolist()}, "mirrored"),
        ({"K": K}, "no transform joins"),
        ({"T_camera_site": LOOK_X}, "no CameraInfo"),
        ({**POSED, "topic": "/nowhere"}, "no images or boxes on this topic"),
    ],
)
def test_unsound_cameras_are_faults(camera: dict[str, Any], reason: str) -> None:
    found = apply({"site_frame": "s", "lidars": {"a": {"T_site_lidar": EYE}}, "cameras": {"cam11": camera}})
    assert found.rig.cameras == ()
    assert reason in reasons(found)["cam11"]


def test_unsound_lidars_are_faults_until_none_is_left() -> None:
    good, bad = {"topic": "/a_points", "T_site_lidar": EYE}, {"topic": "/b_points", "T_site_lidar": SKEWED}
    found = apply({"site_frame": "s", "lidars": {"good": good, "bad": bad}, "cameras": {}})
    assert [lidar.name for lidar in found.rig.lidars] == ["good"]
    assert "not orthonormal" in reasons(found)["bad"]
    in_utm = {"topic": "/b_points", "translation_m": [690_000, 5_300_000, 500]}
    found = apply({"site_frame": "s", "lidars": {"good": good, "far": in_utm}, "cameras": {}})
    assert "it is 5300 km from the origin of the site frame 's', expected at most 200 km" in reasons(found)["far"]
    found = apply({"site_frame": "s", "lidars": {"x": good, "y": good}, "cameras": {}})
    assert reasons(found) == {"y": "another sensor of the rig file has this topic"}


MOVED = {"topic": "/a_points", "translation_m": [1, 0, 0]}
AWAY = {"topic": "/cam11/image", "translation_m": [1, 2, 3]}  # in a frame without a name


@pytest.mark.parametrize(
    ("tree", "reason"),
    [
        ({"site_frame": "s", "lidars": {"a": {"T_site_lidar": SKEWED}}, "cameras": {}}, "no lidar is usable"),
        ({"site_frame": "a", "lidars": {"x": MOVED}, "cameras": {}}, "against itself"),
        (
            {"lidars": {"roof": {"topic": "/nowhere"}}, "cameras": {"left": AWAY}},
            r"no lidar is usable .*roof \(/nowhere\): the recording has no clouds",
        ),
        (
            {"transforms": {"a": {"imu": {"rotation_xyzw": [0, 0, 0, 3]}}}},
            "transforms: imu: rotation_xyzw: expected a quaternion of length 1",
        ),
        ({"transforms": {"a": {"a": {"translation_m": [0, 0, 3]}}}}, "the pose of a moves frame 'a' against itself"),
    ],
)
def test_rigs_that_cannot_be_used(tree: dict[str, Any], reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        apply(tree)


def test_poses_that_refer_to_each_other_are_faults() -> None:
    cameras = {"cam11": {**POSED, "parent": "other"}, "other": {**POSED, "parent": "cam11", "topic": "/other/image"}}
    found = apply({"cameras": cameras}, image_message("/other/image", "o"))
    assert "its pose refers to other: no transform joins" in reasons(found)["cam11"]
    assert "its pose refers to cam11" in reasons(found)["other"]


def test_rounded_rotations_become_true_ones() -> None:
    turn = np.round(Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix(), 4)
    matrix = np.vstack([np.c_[turn, [1, 2, 3]], [0, 0, 0, 1]])
    rig = apply({"site_frame": "s", "lidars": {"a": {"T_site_lidar": matrix.tolist()}}, "cameras": {}}).rig
    rotation = rig.lidars[0].T_site_lidar.matrix[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(rotation, turn, atol=1e-4)


def test_sensors_without_topics_go_by_name_then_by_order() -> None:
    lidars = {"b": {"T_site_lidar": EYE}, "roof": {"T_site_lidar": EYE}, "third": {}}
    found = apply({"site_frame": "s", "lidars": lidars, "cameras": {}})
    assert [(lidar.name, lidar.topic) for lidar in found.rig.lidars] == [("b", "/b_points"), ("roof", "/a_points")]
    assert found.notes == ("roof: has no topic in the rig file; by order it is /a_points",)
    (fault,) = found.faults
    assert (fault.subject, fault.reason) == ("third", "the recording has no topic left for it")


@pytest.mark.parametrize(
    ("tree", "reason"),
    [
        ({"lidar": {}}, "unknown key 'lidar': did you mean 'lidars'"),
        ({"cameras": {"c": {"focal": 3}}}, r"unknown key 'cameras\.c\.focal'; known here:.*boxes_topic"),
        ({"site_frame": "s", "lidars": {"a": {"T_site_lidar": [[1, 2], [3, 4]]}}}, "expected 4 x 4 numbers, found 4"),
        ({"lidars": {"a": {"T_site_lidar": EYE, "time_offset_ms": "soon"}}}, r"lidars\.a\.time_offset_ms"),
        ({"lidars": {"a": {"T_site_lidar": EYE, "time_offset_ms": float("inf")}}}, r"lidars\.a\.time_offset_ms"),
        (
            {"lidars": {"a": {"T_site_lidar": [[1, 0, 0, 0], [0, "1 1", 0, 0], *EYE[2:]]}}},
            r"T_site_lidar: expected a number, found \[\[",
        ),
        ({"site_frame": "s", "lidars": {"a": {"T_site_lidar": EYE, "rpy_deg": [0, 0, 0]}}}, "given twice"),
        ({"cameras": {"c": {"K": K, "P": np.eye(3, 4).tolist()}}}, "given twice"),
        ({"cameras": {"c": {"distortion": [1.0]}}}, "distortion without K"),
        ({"lidars": {"x": {}}, "cameras": {"x": {}}}, "x names a lidar and a camera"),
        ({"lidars": {"a b": {}}}, "lidars.a b: expected text of the form .*, found 'a b'"),
        ({"zones": {"z": [[0, 0], [1, 1]]}}, "at least 3"),
        ({"zones": {"z": {"corners": SQUARE, "use": "avoid"}}}, r"zones\.z\.use.*ignore.*found 'avoid'"),
        ({"zones": {"z": {"use": "ignore"}}}, r"zones\.z\.corners"),
        ({"zones": {"z": {"corners": [[0, 0], [1, float("inf")], [1, 1]]}}}, r"zones\.z\.corners"),
        ({"truth": {"car1": {"topic": "/odom"}}}, r"truth\.car1"),
        ({"truth": {"car1": {"topic": "/odom", "size_m": [1, 2, 0]}}}, r"truth\.car1"),
        ({"truth": {"car1": {"topic": "", "size_m": [1, 2, 3]}}}, r"truth\.car1"),
        ({"truth": {"car1": {**CAR1, "offset_m": [0, 0, float("inf")]}}}, r"truth\.car1"),
    ],
)
def test_mistakes_in_a_rig_file_are_told_in_one_line(tmp_path: Path, tree: dict[str, Any], reason: str) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(tree))
    with pytest.raises(CalibrationError, match=reason) as caught:
        load_rig(tmp_path / "rig.yaml")
    assert "\n" not in str(caught.value)
    assert "rig.yaml" in str(caught.value)


TO_DO = r"rig\.yaml: .*cameras"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        *((f"cameras: {{cam: {{K: TODO, {key}: TODO}}}}".encode(), TO_DO) for key in ("1", "null", "2001-01-01")),
        *((content, r"rig\.yaml") for content in (b"[1, 2]", b"a: [", b"\xff\xfe\x00", None)),
    ],
)
def test_files_that_are_no_rig(tmp_path: Path, content: bytes | None, reason: str) -> None:
    path = tmp_path / "rig.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises((CalibrationError, ConfigError), match=reason):
        load_rig(path)


# --- projections


@given(
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.tuples(*[st.floats(-50, 50)] * 3),
    st.floats(100, 3000),
    st.floats(100, 3000),
    st.floats(1e-3, 1e3),
)
def test_a_projection_comes_apart_into_what_it_was_made_of(
    turn: tuple[float, ...], shift: tuple[float, ...], fx: float, fy: float, scale: float
) -> None:
    camera_K = np.array([[fx, 0.5, 640], [0, fy, 360], [0, 0, 1]])
    Rt = np.c_[Rotation.from_rotvec(turn).as_matrix(), shift]
    found_K, matrix = decompose_projection("P", scale * camera_K @ Rt)
    np.testing.assert_allclose(found_K, camera_K, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(matrix[:3], Rt, atol=1e-6)
    rigid_transform("pose", "camera", "site", matrix)


# --- a rig file over what was recorded


OTHER_K = [[600.0, 0.0, 32.0], [0.0, 600.0, 24.0], [0.0, 0.0, 1.0]]


def merged(*trees: dict[str, Any]) -> RigFile:
    return merge_rigs(
        [(f"{name}.yaml", parse_rig(tree, Path(f"{name}.yaml"))) for name, tree in zip("abc", trees, strict=False)]
    )


def camera(*entries: dict[str, Any]) -> dict[str, Any]:
    """What files say together of one camera."""
    rig = merged(*({"cameras": {"cam": entry}} for entry in entries))
    return (rig.cameras or {})["cam"].model_dump(exclude_defaults=True)


def flat(rows: Any) -> tuple[float, ...]:
    return tuple(np.ravel(rows).tolist())


def test_poses_from_one_file_and_intrinsics_from_another() -> None:
    poses = {
        "site_frame": "/s",
        "lidars": {"velo": {"translation_m": [0, 0, 2]}},
        "cameras": {"cam": {"T_camera_site": LOOK_X}},
    }
    lenses = {"site_frame": "s", "cameras": {"cam": {"K": K}}, "zones": {"z": [[0, 0], [1, 0], [1, 1]]}}
    rig, camera = merged(poses, lenses), {"K": flat(K), "T_camera_site": flat(LOOK_X)}
    assert rig == merged(poses, lenses, {"cameras": poses["cameras"]})
    assert (rig.cameras or {})["cam"].model_dump(exclude_defaults=True) == camera
    assert ({*(rig.lidars or {})}, {*(rig.zones or {})}) == ({"velo"}, {"z"})


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ([{"K": K, "distortion": [0.1]}, {"K": OTHER_K}], {"K": flat(OTHER_K)}),
        ([{"T_camera_site": EYE, "K": K}, {"T_site_camera": LOOK_X}], {"K": flat(K), "T_site_camera": flat(LOOK_X)}),
        ([{"T_camera_site": EYE, "parent": "imu"}, {"rpy_deg": [1, 2, 3]}], {"rpy_deg": (1, 2, 3)}),
        (
            [{"rpy_deg": [1, 2, 3]}, {"translation_m": [4, 5, 6], "parent": "imu"}],
            {"translation_m": (4, 5, 6), "parent": "imu"},
        ),
        (
            [{"P": (np.array(K) @ np.eye(3, 4)).tolist()}, {"K": OTHER_K, "T_camera_site": EYE}],
            {"K": flat(OTHER_K), "T_camera_site": flat(EYE)},
        ),
        ([{"K": K, "T_camera_site": EYE}, {"P": np.eye(3, 4).tolist()}], {"P": flat(np.eye(3, 4))}),
        ([{"K": "TODO"}, {"K": K}], {"K": flat(K)}),
        ([{"K": K}, {"K": "TODO"}], {"K": flat(K)}),
        ([{"translation_m": [1, 2, 3]}, {"T_camera_site": "TODO"}], {"translation_m": (1, 2, 3)}),
        ([{"K": "TODO"}, {"width_px": 3}], {"width_px": 3, "missing": {"K": "still TODO in a.yaml"}}),
    ],
)
def test_later_files_replace_what_they_give(entries: list[dict[str, Any]], expected: dict[str, Any]) -> None:
    assert camera(*entries) == expected


def test_a_sensor_is_known_by_its_topic_too() -> None:
    written = {"cameras": {"left": {"topic": "/cam0/image_raw/compressed"}, "right": {"topic": "/cam1/image_raw"}}}
    chain = {
        "cameras": {
            "cam0": {"topic": "/cam0/image_raw", "K": K},
            "cam1": {"topic": "/cam1/image_raw", "parent": "cam0", "T_camera_site": EYE},
        }
    }
    cameras = merged(written, chain).cameras or {}
    assert list(cameras) == ["left", "right"]
    left, right = cameras.values()
    np.testing.assert_array_equal(np.array(left.K), np.ravel(K))
    assert right.parent == "left"


@pytest.mark.parametrize(
    ("trees", "reason"),
    [
        (
            [{"site_frame": "site"}, {"site_frame": "base_link"}],
            "a.yaml and b.yaml: site_frame is 'site' in one and 'base_link' in the other: keep one of them",
        ),
        (
            [{"lidars": {"v": {"frame_id": "v1"}}}, {}, {"lidars": {"v": {"frame_id": "v2"}}}],
            "a.yaml and b.yaml and c.yaml: v.frame_id is 'v1' in one and 'v2' in the other: keep one of them",
        ),
        (
            [{"lidars": {"x": {}}}, {"cameras": {"x": {}}}],
            "a.yaml and b.yaml: x names a lidar and a camera: every sensor needs a name of its own",
        ),
    ],
)
def test_contradictions_are_refused_in_one_line(trees: list[dict[str, Any]], reason: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        merged(*trees)
    assert str(caught.value) == reason


MATRICES = st.sampled_from([flat(EYE), flat(LOOK_X)])
POSES = st.one_of(
    st.fixed_dictionaries({"T_camera_site": MATRICES}),
    st.fixed_dictionaries({"T_site_camera": MATRICES}),
    st.fixed_dictionaries({"translation_m": st.just((1.0, 2.0, 3.0)), "rpy_deg": st.just((4.0, 5.0, 6.0))}),
)
LENSES = st.fixed_dictionaries(
    {"K": st.sampled_from([flat(K), flat(OTHER_K)])},
    optional={"distortion": st.just((0.1,)), "distortion_model": st.just("equidistant")},
)
CAMERAS = st.dictionaries(
    st.sampled_from(["one", "two"]),
    st.tuples(
        POSES | st.just({}), LENSES | st.just({}), st.fixed_dictionaries({}, optional={"width_px": st.just(64)})
    ).map(lambda parts: {**parts[0], **parts[1], **parts[2]}),
)
RIGS = st.fixed_dictionaries({}, optional={"cameras": CAMERAS, "ground_height_m": st.floats(-3, 3)})


@given(RIGS, RIGS, RIGS)
def test_it_does_not_matter_which_two_are_taken_together_first(
    first: dict[str, Any], second: dict[str, Any], third: dict[str, Any]
) -> None:
    a, b, c = map(merged, (first, second, third))
    left = merge_rigs([("ab", merge_rigs([("a", a), ("b", b)])), ("c", c)])
    right = merge_rigs([("a", a), ("bc", merge_rigs([("b", b), ("c", c)]))])
    assert left == right == merged(first, second, third)


def test_vehicles_of_the_truth_are_merged_by_name() -> None:
    first = {"car1": {"topic": "/a", "size_m": [4, 2, 1]}, "car2": {"topic": "/b", "size_m": [1, 1, 1]}}
    second = {"car1": {"topic": "/c", "size_m": [5, 2, 1], "class": "bus"}}
    assert merged({"truth": first}, {}, {"truth": second}).vehicles == {
        "car1": TruthVehicle("/c", "bus", (5, 2, 1)),
        "car2": TruthVehicle("/b", "car", (1, 1, 1)),
    }


PAGE = (ROOT / "docs" / "rig.md").read_text(encoding="utf-8")
EXAMPLE = PAGE.split("```yaml\n")[1].split("```")[0]


def test_the_example_is_a_rig(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(EXAMPLE)
    lidars = [cloud(topic, topic[1:5]) for topic in ("/roof/points", "/bumper/points")]
    topics = ("/front/image_raw/compressed", "/left/image_raw", "/right/image_raw", "/rear/image_raw")
    cameras = [image_message(topic, size=(1280, 720)) for topic in topics]
    found = discover([*lidars, *cameras], load_rig(tmp_path / "rig.yaml"))
    assert [(fault.sensor, fault.reason) for fault in found.faults] == [
        ("rear", "extrinsics are still TODO in rig.yaml")
    ]
    assert [camera.name for camera in found.rig.cameras] == ["front", "left", "right"]
    forward = [camera.T_camera_site.inverse().matrix[:3, 2] for camera in found.rig.cameras]
    np.testing.assert_allclose(forward, [[1, 0, 0], [0, 1, 0], [0, -1, 0]], atol=1e-6)
    np.testing.assert_allclose(found.rig.lidars[1].T_site_lidar.translation, [3.6, 0, 0.5])
    assert found.transforms.are_joined("base_link", "imu_optical")


@pytest.mark.parametrize("model", [RigFile, LidarEntry, CameraEntry, Pose, TruthEntry])
def test_every_key_is_explained_and_shown(model: Any) -> None:
    explained = set(re.findall(r"`(\w+)`", PAGE.split("| key | meaning |")[1].split("\n\n")[0]))
    keys = {field.alias or name for name, field in model.model_fields.items()} - {"missing", "camera_info"}
    assert keys <= explained
    shown = yaml.safe_load(EXAMPLE)
    sensors = [entry for kind in ("lidars", "cameras", "truth") for entry in shown[kind].values()]
    assert keys <= {*shown, *(key for sensor in sensors for key in sensor)}
