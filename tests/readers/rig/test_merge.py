"""Several rig files: what later ones add, replace and may not contradict."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.rig import TruthVehicle
from lidcam.readers.rig.rig_file import merge_rigs
from lidcam.readers.rig.schema import RigFile, parse_rig

EYE = np.eye(4).tolist()
K = [[500.0, 0.0, 32.0], [0.0, 500.0, 24.0], [0.0, 0.0, 1.0]]
OTHER_K = [[600.0, 0.0, 32.0], [0.0, 600.0, 24.0], [0.0, 0.0, 1.0]]
LOOK_X = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]


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
