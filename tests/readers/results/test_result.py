"""Results read back: written by the writer of results itself, so that both agree on every number."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import builders
import numpy as np
import pytest
import yaml
from frames import CONFIG, PERIOD_NS, RIG, START_NS, frame, written_result
from helpers import MIB, at_most
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from memory_recording import MemoryRecording
from track_messages import track, track_array

from lidcam.pipeline.core.errors import CalibrationError, ConfigError, RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.results.attached_records import is_result
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.rig.rig_file import rig_yaml

FRAMES = 3


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written_result(tmp_path_factory.mktemp("result") / "out.mcap", [frame(index) for index in range(FRAMES)])


def test_frames_are_read_back(path: Path) -> None:
    with open_result(path) as result:
        assert (result.sources, result.cameras) == (("lidar", "fused"), ("left", "right"))
        found = list(result.frames())
        assert result.notes == ()
    assert [one.index for one in found] == [0, 1, 2]
    for index, one in enumerate(found):
        wrote = frame(index)
        assert (one.stamp_ns, one.log_time_ns) == (wrote.bundle.stamp_ns, wrote.bundle.log_time_ns)
        assert one.skew_ns == round(wrote.bundle.skew_ns, -3)  # to the microsecond
        assert [*one.sources] == ["lidar", "fused"]
        for source, boxes in (("lidar", wrote.detections.lidar), ("fused", wrote.fused.objects)):
            read = one.sources[source].boxes
            assert (read.stamp_ns, read.frame_id) == (boxes.stamp_ns, "site")
            for name in ("centers", "sizes", "yaws", "scores", "covariances"):
                np.testing.assert_allclose(getattr(read, name), getattr(boxes, name), rtol=0, atol=1e-6)
            np.testing.assert_array_equal(read.class_ids, boxes.class_ids)
            np.testing.assert_array_equal(one.sources[source].track_ids, [UNKNOWN] * len(boxes))
        assert [*one.cameras] == ["left", "right"]
        for camera, boxes2d in wrote.detections.cameras.items():
            assert one.cameras[camera].stamp_ns == boxes2d.stamp_ns
            np.testing.assert_allclose(one.cameras[camera].xyxy, boxes2d.xyxy, atol=1e-4)
            np.testing.assert_array_equal(one.cameras[camera].class_ids, boxes2d.class_ids)


def test_rig_settings_and_origin(path: Path) -> None:
    with open_result(path) as result:
        assert result.config == CONFIG
        assert result.metadata["version"] == "1.2.3"
        assert rig_yaml(result.rig) == rig_yaml(RIG)
        assert [camera.model.model for camera in result.rig.cameras] == ["plumb_bob", "plumb_bob"]
        assert [zone.name for zone in result.rig.zones] == ["intersection", "circle"]


def test_motion_is_joined_by_the_ids_of_tracks() -> None:
    def frame_at(stamp_ns: int, *tracks: dict[str, Any]) -> list[RawMessage]:
        objects = detection3d_array(["7", "9", "", "8"], stamp_ns=stamp_ns)
        return [objects, *([track_array(tracks, stamp_ns=stamp_ns)] if tracks else [])]

    told = frame_at(1, track(8, (1, 2), 3, source="predicted"), track(7, (4, 5)), track(6, (9, 9)), track(0))
    recording = MemoryRecording([*told, *frame_at(2)])
    with Result(Path("out.mcap"), recording, {}, CONFIG, RIG, ()) as result:
        first, second = (one.sources["fused"] for one in result.frames())
        assert result.notes == ("out.mcap: tracks that are not used, track without a number: 1",)
    motion = first.motion
    assert motion is not None
    np.testing.assert_array_equal(first.track_ids, [7, 9, UNKNOWN, 8])
    np.testing.assert_array_equal(motion.velocities, [[4, 5], [np.nan] * 2, [np.nan] * 2, [1, 2]])
    np.testing.assert_array_equal(motion.yaw_rates, [0, np.nan, np.nan, 3])
    np.testing.assert_array_equal(motion.is_predicted, [False, False, False, True])
    assert second.motion is None


def detection3d_array(ids: list[str], *, stamp_ns: int) -> RawMessage:
    box = {"center": {"orientation": {"w": 1.0}}, "size": {"x": 4.0, "y": 2.0, "z": 1.5}}
    results = [{"hypothesis": {"class_id": "car", "score": 0.5}}]
    body = {
        "header": builders.header(stamp_ns, "site"),
        "detections": [{"id": id_, "bbox": box, "results": results} for id_ in ids],
    }
    return builders.raw("/fused/detections", "vision_msgs/msg/Detection3DArray", body, stamp_ns)


def test_frames_without_objects_and_with_one_log_time(tmp_path: Path) -> None:
    """A recorder with a coarse clock gives two frames one log time."""
    with open_result(written_result(tmp_path / "none.mcap", [])) as result:
        assert list(result.frames()) == []
    same = [frame(index, objects=0) for index in range(3)]
    same = [replace(one, bundle=replace(one.bundle, log_time_ns=START_NS)) for one in same]
    with open_result(written_result(tmp_path / "a.mcap", same)) as result:
        found = list(result.frames())
    assert [one.stamp_ns for one in found] == [START_NS + index * PERIOD_NS for index in range(3)]
    assert [len(one.sources["fused"]) for one in found] == [0, 0, 0]
    assert [len(one.cameras["left"]) for one in found] == [2, 2, 2]


def test_settings_on_top(path: Path) -> None:
    with open_result(path, ["evaluate.iou=[0.5]"]) as result:
        assert result.config.evaluate.iou == (0.5,)
        assert result.config.fuse == CONFIG.fuse
    with pytest.raises(ConfigError, match=r"evaluate\.ious"):
        open_result(path, ["evaluate.ious=[0.5]"])


def test_boxes_of_a_class_that_the_settings_do_not_have(path: Path, tmp_path: Path) -> None:
    only_cars = [dump for dump in CONFIG.model_dump(mode="json")["classes"] if dump["name"] == "car"]
    with open_result(path, [f"classes={yaml.safe_dump(only_cars, default_flow_style=True)}"]) as result:
        found = list(result.frames())
        assert {note.split(": ", 1)[1] for note in result.notes} == {
            "3D boxes of class 'pedestrian', which the settings do not have: 6",
            "3D boxes of class 'truck', which the settings do not have: 6",
            "2D boxes that are not used, class 'pedestrian' is not configured: 3",
        }
    assert [len(one.sources["fused"]) for one in found] == [1, 1, 1]
    one = frame(0)
    of_no_class = replace(one.fused.objects, class_ids=np.array([0, len(CONFIG.classes), 3], np.int32))
    one = replace(one, fused=replace(one.fused, objects=of_no_class))
    config = load_config(CONFIG, {"fuse.unknown": True})
    with open_result(written_result(tmp_path / "a.mcap", [one], config=config)) as result:
        (known,) = result.frames()
        assert known.sources["fused"].boxes.class_ids.tolist() == [0, 3]
        assert not any("unknown" in note for note in result.notes)


def test_settings_of_other_versions(tmp_path: Path) -> None:
    tree = CONFIG.model_dump(mode="json")
    del tree["evaluate"], tree["fuse"]["min_score"]
    tree["telepathy"] = {"range_m": 3}
    tree["fuse"]["magic"] = True
    tree["sync"]["slop_s"] = "a lot"
    tree["classes"][0]["colour"] = "red"
    del tree["classes"][1]["size_m"]
    with open_result(written_result(tmp_path / "old.mcap", [frame()], config_yaml=yaml.safe_dump(tree))) as result:
        assert result.config == CONFIG
        assert len(result.notes) == 1
        for part in ("old.mcap is of lidcam 1.2.3", "telepathy", "fuse.magic", "sync.slop_s", "classes"):
            assert part in result.notes[0]


# --- files that are no results


SOUND = {"lidcam.yaml": "{}", "rig.yaml": rig_yaml(RIG)}
CAMERA = {"width_px": 4, "height_px": 4, "frame_id": "c"}
TWICE = CONFIG.model_dump(mode="json")
TWICE["classes"][1]["name"] = "car"


def records_only(path: Path, name: str, attachments: dict[str, str], **metadata: str) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        if name:
            writer.add_metadata(name, {"version": "1.2.3", **metadata})
        for attached, text in attachments.items():
            writer.add_attachment(0, 0, attached, "application/yaml", text.encode())
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
    return path


def in_rig(**tree: object) -> dict[str, str]:
    return SOUND | {"rig.yaml": yaml.safe_dump({"site_frame": "site", **tree})}


@pytest.mark.parametrize(
    ("attachments", "reason"),
    [
        ({"rig.yaml": SOUND["rig.yaml"]}, "found none of lidcam.yaml: a tool that rewrote it left them out"),
        ({"lidcam.yaml": "{}"}, "found none of rig.yaml: a tool that rewrote it left them out"),
        (SOUND | {"lidcam.yaml": "[1, 2]"}, "expected a mapping in the attached lidcam.yaml, found list"),
        (SOUND | {"lidcam.yaml": "a: ["}, "the attached lidcam.yaml is not YAML"),
        (SOUND | {"lidcam.yaml": "7"}, "expected a mapping in the attached lidcam.yaml, found int"),
        (SOUND | {"lidcam.yaml": yaml.safe_dump(TWICE)}, "found others (written by version 1.2.3)"),
        (in_rig(lidars={"top": {"topic": "/a"}}), "expected T_site_lidar of top in the attached rig.yaml"),
        (in_rig(cameras={"front": CAMERA}), "expected T_camera_site, K, width_px and height_px of front in the attach"),
        (in_rig(lidars=5), "a.mcap: lidars: expected"),
    ],
)
def test_attachments_that_cannot_be_used(tmp_path: Path, attachments: dict[str, str], reason: str) -> None:
    with pytest.raises((RecordingError, CalibrationError), match=re.escape(reason)):
        open_result(records_only(tmp_path / "a.mcap", "lidcam", attachments))


def test_files_that_are_no_results(tmp_path: Path) -> None:
    (tmp_path / "a\nb.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(50))
    (tmp_path / "empty.mcap").write_bytes(b"")
    recorded = tmp_path / "recorded.mcap"
    builders.write_mcap(recorded, [builders.raw("/a", "std_msgs/msg/String", {"data": "a"}, 1)])
    for path, reason in (
        (tmp_path / "a\nb.bag", "found another kind of file"),
        (tmp_path / "empty.mcap", "found another kind of file"),
        (tmp_path / "nothing.mcap", "found no such file"),
        (tmp_path, "found a folder: .*empty.mcap, .*recorded.mcap"),
        (recorded, "found a recording; run `lidcam pro"),
    ):
        with pytest.raises(RecordingError, match=f"expected a result of lidcam, .*{reason}") as caught:
            open_result(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("is_closed", [True, False])
def test_recordings_are_told_from_results_without_reading_all_of_them(tmp_path: Path, is_closed: bool) -> None:
    """One with a large attachment; one with messages outside of chunks, whose recorder was killed."""
    path, large = tmp_path / "large.mcap", bytes(8 * MIB)
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=is_closed)
        writer.start(profile="", library="test")
        channel = writer.register_channel(topic="/a", message_encoding="json", schema_id=0)
        for number in range(4):
            if is_closed:
                writer.add_attachment(0, 0, f"map_{number}.pcd", "", large)
            else:
                writer.add_message(channel, number, large, number)
        if is_closed:
            writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
    with at_most(24):
        assert not is_result(path)


def test_result_that_was_cut_off(path: Path, tmp_path: Path) -> None:
    """Its beginning says what it is; whole chunks are read, and the loss is told."""
    content = path.read_bytes()
    with path.open("rb") as stream:
        chunks = [record for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Chunk)]
    cut = tmp_path / "cut.mcap"
    whole = content.index(chunks[-1].data) + len(chunks[-1].data)
    cut.write_bytes(content[:whole])
    with open_result(cut) as result:
        assert len(list(result.frames())) == FRAMES
        assert any("cut.mcap" in note for note in result.notes)
    cut.write_bytes(content[: whole - 100])  # its only chunk
    with pytest.raises(RecordingError, match=r"cut\.mcap: the file is damaged or was not closed"):
        open_result(cut)


def test_result_whose_index_is_damaged(path: Path, tmp_path: Path) -> None:
    content = bytearray(path.read_bytes())
    at = content.rindex(b"lidcam.yaml")  # in the index of attachments
    content[at - 12 : at] = b"\xff" * 12
    (tmp_path / "bad.mcap").write_bytes(content)
    with open_result(tmp_path / "bad.mcap") as result:
        assert len([*result.frames()]) == FRAMES


def test_message_that_cannot_be_decoded(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_result(path) as result:
        broken = list(result.recording.messages(["/fused/detections", "/diagnostics", "/left/detections"]))
        for row, one in enumerate(broken):
            if one.log_time_ns < START_NS + 9:
                broken[row] = one._replace(data=bytes(one.data)[:40])
        monkeypatch.setattr(result.recording, "messages", lambda topics: [m for m in broken if m.topic in topics])
        found = list(result.frames())
        assert len(result.notes) == 3
        told = re.compile(r"messages of /\S+ that are not used: 1, the first: /\S+: 40 bytes")
        assert all(map(told.search, result.notes))
    assert [[*one.sources] for one in found] == [[], ["fused"], ["fused"]]
    assert [[*one.cameras] for one in found] == [[], ["left"], ["left"]]
    assert (found[0].skew_ns, found[1].skew_ns is None) == (None, False)
    assert [one.stamp_ns for one in found] == [START_NS + index * PERIOD_NS for index in range(FRAMES)]


def test_boxes_that_cannot_be_used_are_noted(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    box = {"center": {"orientation": {"w": 1.0}}, "size": {"x": 4.0, "y": 0.0, "z": 1.5}}
    boxes = {"detections": [{"results": [{"hypothesis": {"class_id": "car", "score": 1.0}}], "bbox": box}] * 2}
    status = [{"name": "lidcam: synchronisation", "values": [{"key": "skew_ms", "value": "a lot"}]}]
    raws = [
        builders.raw("/fused/detections", "vision_msgs/msg/Detection3DArray", boxes, 5),
        builders.raw("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", {"status": status}, 5),
    ]
    with open_result(path) as result:
        monkeypatch.setattr(result.recording, "messages", lambda _: raws)
        (found,) = result.frames()
        assert (len(found.sources["fused"]), found.skew_ns) == (0, None)
        assert result.notes == ("out.mcap: 3D boxes that are not used, box without a volume or not finite: 2",)
