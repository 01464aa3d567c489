import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes3D
from lidcam.readers.truth.openlabel import OpenLabelTruth, is_openlabel

START_S = 1_646_667_310
T_SITE_LIDAR = np.array([[0.0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 7], [0, 0, 0, 1]])
BOX = [1, 2, 3, 0, 0, 0, 1, 4, 2, 1.5]


def rig() -> Rig:
    lidar = LidarSensor("south", "/south", Transform("site", "lidar_south", T_SITE_LIDAR))
    model = CameraModel("cam_frame", 8, 6, np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]), "plumb_bob", np.zeros(0))
    camera = CameraSensor("cam", "/cam", "", model, Transform("cam_frame", "site", np.eye(4)))
    return Rig("site", (lidar,), (camera,), ())


def tree(frames: dict[str, Any], systems: dict[str, Any] | None = None) -> dict[str, Any]:
    root: dict[str, Any] = {
        "metadata": {"schema_version": "1.0.0"},
        "objects": {"a": {"name": "car1", "type": "car"}, "b": {"name": "p", "type": "Pedestrian"}},
        "frames": frames,
    }
    return {"openlabel": root | ({} if systems is None else {"coordinate_systems": systems})}


def frame(*boxes: Any, stamp: Any = None, uuids: str = "ab", **more: Any) -> dict[str, Any]:
    objects = {
        uuid: {"object_data": {"cuboid": [{"name": "shape", "val": box, **more}]}}
        for uuid, box in zip(uuids, boxes, strict=False)
    }
    return {"objects": objects, **({} if stamp is None else {"frame_properties": {"timestamp": stamp}})}


def at(source: OpenLabelTruth, stamp_ns: int = 0, frame: int = 0) -> TruthBoxes3D:
    found = source.at(stamp_ns, frame=frame)
    assert found is not None
    return found


def truth(tmp_path: Path, content: Any) -> OpenLabelTruth:
    path = tmp_path / "labels.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return OpenLabelTruth(path, rig(), Config())


def boxes_in(tmp_path: Path, system: str | None, systems: dict[str, Any] | None) -> TruthBoxes3D:
    more = {} if system is None else {"coordinate_system": system}
    return at(truth(tmp_path, tree({"0": frame(BOX, **more)}, systems)), 5)


@pytest.mark.parametrize(
    ("system", "systems", "expected"),
    [
        (None, None, [1, 2, 3]),
        ("site", None, [1, 2, 3]),
        ("lidar_south", None, [8, 21, 10]),
        ("south", None, [8, 21, 10]),
        ("cam_frame", {"cam_frame": {"type": "sensor", "parent": ""}}, [1, 2, 3]),
        (None, {"lidar_south": {"type": "sensor", "parent": "base"}}, [8, 21, 10]),
        (None, {"base": {"type": "scene_cs", "parent": ""}, "south": {"parent": "base"}}, [8, 21, 10]),
    ],
)
def test_boxes_stand_in_the_system_that_is_named(
    tmp_path: Path, system: str | None, systems: dict[str, Any] | None, expected: list[float]
) -> None:
    found = boxes_in(tmp_path, system, systems)
    assert (found.stamp_ns, found.frame_id, found.labels.tolist()) == (5, "site", ["car"])
    np.testing.assert_allclose(found.centers, [expected], atol=1e-12)
    np.testing.assert_allclose(found.sizes, [[4, 2, 1.5]])
    np.testing.assert_allclose(found.yaws, [0 if expected[0] == 1 else np.pi / 2], atol=1e-12)
    assert Config().class_names[found.class_ids[0]] == "car"


def test_systems_are_joined_by_their_poses(tmp_path: Path) -> None:
    """The boxes stand in `world`; the rig knows the lidar, which stands in `base`, which stands in `world`."""
    turn = Rotation.from_euler("z", 90, degrees=True)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), (0, 0, 1)
    pose = {"quaternion": turn.as_quat().tolist(), "translation": [5, 0, 0]}
    systems = {
        "world": {"type": "scene_cs", "parent": ""},
        "base": {"parent": "world", "pose_wrt_parent": {"matrix4x4": matrix.ravel().tolist()}},
        "south": {"parent": "base", "pose_wrt_parent": pose},
    }
    T_world_south = matrix @ Transform.from_quaternion("b", "s", [5, 0, 0], turn.as_quat()).matrix
    found = boxes_in(tmp_path, "world", systems)
    expected = T_SITE_LIDAR @ np.linalg.inv(T_world_south) @ [1, 2, 3, 1]
    assert found.frame_id == "site"
    np.testing.assert_allclose(found.centers, [expected[:3]], atol=1e-12)


def test_a_system_that_the_rig_does_not_know_is_left_to_the_recorded_transforms(tmp_path: Path) -> None:
    found = boxes_in(tmp_path, "map", None)
    assert found.frame_id == "map"
    np.testing.assert_allclose(found.centers, [[1, 2, 3]])
    mixed = tree({"0": frame(BOX, BOX, coordinate_system="map")})
    mixed["openlabel"]["frames"]["0"]["objects"]["b"]["object_data"]["cuboid"][0]["coordinate_system"] = "south"
    with pytest.raises(RecordingError, match="frame 0 has boxes in 'map', which nothing joins with south"):
        truth(tmp_path, mixed).at(0, frame=0)


def test_parents_that_go_round_in_a_circle(tmp_path: Path) -> None:
    pose = {"pose_wrt_parent": {"quaternion": [0, 0, 0, 1]}}
    systems = {"a": {"parent": "b", **pose}, "b": {"parent": "a", **pose}}
    assert boxes_in(tmp_path, "a", systems).frame_id == "a"


def test_which_system_is_meant_has_to_be_clear(tmp_path: Path) -> None:
    systems = {"one": {"parent": ""}, "two": {"parent": ""}}
    with pytest.raises(RecordingError, match=r"not one of one, two is a lidar of the rig \(lidar_south, south\)"):
        boxes_in(tmp_path, None, systems)


def test_the_form_of_tum_traffic_and_a_plain_one(tmp_path: Path) -> None:
    attributes = {"text": [{"name": "body_color", "val": "red"}], "num": [{"name": "num_points", "val": 35}]}
    data = {"name": "CAR_1", "type": "CAR", "cuboid": {"name": "shape3D", "val": BOX, "attributes": attributes}}
    image = {"name": "TRAILER_2", "type": "TRAILER", "bbox": [{"name": "shape2D", "val": [1, 2, 3, 4]}]}
    frames = {"0": {"objects": {"x": {"object_data": data}, "y": {"object_data": image}}}}
    source = truth(tmp_path, {"openlabel": {"frames": frames}})
    found = at(source)
    assert (found.labels.tolist(), found.lidar_points.tolist()) == (["CAR"], [35])
    assert Config().class_names[found.class_ids[0]] == "car"
    assert source.notes[-1].endswith("1 objects without a cuboid are not used")
    assert source.in_image("cam", 0, frame=0) is None
    plain = tree({"0": frame([1, 2, 3, 0, 0, 0.5, 4, 2, 1.5])})  # angles in place of a quaternion
    plain["openlabel"]["objects"]["a"] = "?"
    found = at(truth(tmp_path, plain))
    assert (found.yaws.tolist(), found.labels.tolist(), found.class_ids.tolist()) == ([0.5], [""], [UNKNOWN])


def moved(x: float) -> list[float]:
    return [x, *BOX[1:]]


@pytest.mark.parametrize("form", ["s", "text", "ms", "us", "ns"])
def test_frames_with_timestamps_are_brought_to_the_time(tmp_path: Path, form: str) -> None:
    def stamp(k: int) -> Any:
        ms = START_S * 1000 + 100 * k
        return {"s": ms / 1000, "text": str(ms / 1000), "ms": ms, "us": ms * 1000, "ns": str(ms * 10**6)}[form]

    source = truth(tmp_path, tree({str(k): frame(moved(k), moved(-k), stamp=stamp(k)) for k in range(30)}))
    for k in (0.0, 3.0, 7.5, 22.25):
        found = at(source, START_S * 10**9 + round(k * 1e8), 99)
        np.testing.assert_allclose(found.centers[:, 0], [k, -k], atol=1e-4)
        assert found.track_ids.tolist() == [0, 1]
    assert source.at((START_S + 60) * 10**9, frame=99) is None
    assert source.notes == ()


def test_stamps_of_some_frames_only_and_stamps_that_step_back(tmp_path: Path) -> None:
    source = truth(tmp_path, tree({"0": frame(BOX, stamp=START_S), "1": frame(BOX)}))
    with pytest.raises(RecordingError, match="frame 1 has no timestamp, others have"):
        source.at(START_S * 10**9, frame=0)
    source = truth(tmp_path, tree({str(k): frame(BOX, stamp=START_S - 10 * k) for k in range(3)}))
    with pytest.raises(RecordingError, match="timestamps step back"):
        source.at(START_S * 10**9, frame=0)


def test_frames_without_timestamps_have_numbers(tmp_path: Path) -> None:
    source = truth(tmp_path, tree({"10": frame(moved(10)), "2": frame(moved(2)), "3": {"objects": {}}}))
    found = [source.at(0, frame=k) for k in (0, 2, 2, 3, 4, 10, 11)]
    places = [None if one is None else one.centers[:, 0].tolist() for one in found]
    assert places == [None, [2], [2], [], None, [10], None]
    (note,) = source.notes
    assert note.endswith("no timestamps, matched with the frames of the result by their numbers")


def test_a_folder_of_files_is_a_sequence(tmp_path: Path) -> None:
    for k in range(12):
        stamped = tree({"0": frame(moved(k), stamp=START_S + 0.1 * k, uuids="a")})
        (tmp_path / f"frame_{k}.json").write_text(json.dumps(stamped))
    source = OpenLabelTruth(tmp_path, rig(), Config())
    np.testing.assert_allclose(at(source, START_S * 10**9 + 1_050_000_000).centers[0, 0], 10.5, atol=1e-4)
    for path in tmp_path.glob("*.json"):
        path.write_text(path.read_text().replace("timestamp", "other"))
    source = OpenLabelTruth(tmp_path, rig(), Config())
    assert [one.centers[0, 0] for k in (0, 10, 11) if (one := source.at(0, frame=k)) is not None] == [0, 10, 11]


def altered(*path: str, value: Any) -> dict[str, Any]:
    systems = {"south": {"parent": "", "pose_wrt_parent": {"quaternion": [0, 0, 0, 1]}}}
    whole = deepcopy(tree({"0": frame(BOX, stamp=START_S)}, systems))
    part: Any = whole["openlabel"]
    for key in path[:-1]:
        part = part[0] if key == "[]" else part[key]
    part[path[-1]] = value
    return whole


CUBOID = ("frames", "0", "objects", "a", "object_data", "cuboid", "[]")
POSE = ("coordinate_systems", "south", "pose_wrt_parent")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("{", "expected OpenLABEL, found no JSON"),
        ("[" * 100_000, "expected OpenLABEL, found no JSON"),
        ("[]", "expected a section, found []"),
        ({"frames": {}}, "openlabel is missing"),
        ({"openlabel": 5}, "openlabel: expected a section"),
        (tree({}), "expected OpenLABEL with frames, found none"),
        (altered("frames", value={"x": {}}), "frames: expected numbers as keys, found 'x'"),
        (altered("frames", "0", value=[]), "frames.0: expected a section"),
        (altered("frames", "0", "frame_properties", "timestamp", value="today"), "expected a time since 1970"),
        (altered("frames", "0", "frame_properties", "timestamp", value=10**30), "after January 2038"),
        (altered(*CUBOID, "val", value=BOX[:-2]), "val: expected 10 numbers (position, quaternion, size) or 9"),
        (altered(*CUBOID, "val", value="abc"), "cuboid.0.val: expected a list"),
        (altered(*CUBOID, "val", value=[float("nan")] * 10), "cuboid.0.val.0: expected"),
        (altered(*CUBOID, "val", value=[*BOX[:3], 1, 1, 1, 1, *BOX[7:]]), "expected a quaternion of length 1, found 2"),
        (altered(*CUBOID, "val", value=[*BOX[:7], 4, 0, 1]), "expected a box with a volume, found 4 x 0 x 1 m"),
        (altered(*POSE, value={"matrix4x4": [1, 2]}), "matrix4x4: expected a list with at least 16 items"),
        (altered(*POSE, value={"euler_angles": [1, 2, 3]}), "expected matrix4x4, or quaternion and translation"),
        (altered(*POSE, value={"quaternion": [0, 0, 1]}), "quaternion: expected a list with at least 4 items"),
    ],
)
def test_malformed_files(tmp_path: Path, content: Any, problem: str) -> None:
    with pytest.raises(RecordingError) as caught:
        truth(tmp_path, content)
    assert problem in str(caught.value)
    assert "labels.json: " in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("head", "expected"), [(' \n{"openlabel"', True), ("[1]", False), ("", False)])
def test_what_looks_like_openlabel(head: str, expected: bool) -> None:
    assert is_openlabel(head) is expected


def test_more_boxes_in_a_frame_than_may_be(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(tree({"0": frame(BOX, BOX)})))
    with pytest.raises(RecordingError, match=r"labels\.json: frame 0: 2 boxes, expected at most 1: raise limit_scale"):
        OpenLabelTruth(path, rig(), load_config(None, ["limit_scale=0.0005"]))


def test_more_values_in_a_file_than_may_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.readers.truth.openlabel_text.MAX_OPENLABEL_VALUES", 20)
    with pytest.raises(RecordingError, match=r"at most 20 values, found \d+: give a folder with a file for each frame"):
        truth(tmp_path, tree({"0": frame(BOX, BOX)}))


def test_only_frames_that_are_reached_are_checked(tmp_path: Path) -> None:
    source = truth(tmp_path, tree({"0": frame(BOX), "1": frame([1, 2])}))
    assert len(at(source)) == 1
    with pytest.raises(RecordingError, match=r"frames\.1\.objects\.a\..*val: expected 10"):
        source.at(0, frame=1)
