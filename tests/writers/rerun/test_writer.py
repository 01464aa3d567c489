import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import CONFIG, PROVENANCE, RIG, START_NS, frame, tracks_of
from lidar_scene import combined, point_cloud

from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import FrameResult, Missing
from lidcam.pipeline.core.messages import Drop, RawMessage, VideoPart
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.readers.messages.image import decode_any_image
from lidcam.writers.drawing import DrawnBoxes2D
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.palette import MATCHED
from lidcam.writers.provenance import Provenance
from lidcam.writers.rerun.archetypes import MAX_POINTS, cloud_points, labels_2d
from lidcam.writers.rerun.writer import RerunResultWriter
from lidcam.writers.viewpoint import SURVEYED_FRAMES

RERUN = Path(sys.executable).with_name("rerun")


def unreadable(message: RawMessage) -> Image:
    raise MessageError(f"{message.topic}: no image")


def write(
    path: Path,
    frames: Iterable[FrameResult],
    *,
    config: Config = CONFIG,
    provenance: Provenance = PROVENANCE,
    decode: Callable[[RawMessage], Image] = decode_any_image,
) -> list[tuple[Drop, ...]]:
    output = OutputFile(path, path)
    with RerunResultWriter(output, RIG, config, provenance, decode_any_image=decode) as writer:
        return [writer.write(result) for result in frames]


def rerun(home: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Rerun's own command, with its settings in a folder of the test."""
    environment = {"HOME": str(home), "XDG_CONFIG_HOME": str(home), "XDG_DATA_HOME": str(home), "PATH": "/usr/bin:/bin"}
    command = [str(RERUN), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


def printed(home: Path, detail: str = "-v") -> str:
    """Rerun's own list of what `out.rrd` in a folder holds."""
    return rerun(home, "rrd", "print", detail, home / "out.rrd").stdout


def not_told(home: Path, *texts: str) -> list[str]:
    """Those of some texts that `out.rrd` in a folder does not hold."""
    found = printed(home, "-vvv")
    return [text for text in texts if text not in found]


def entities(text: str) -> set[str]:
    found = set(re.findall(r"(/(?:world|metrics)[\w/.]*)", text))
    return {path for path in found if "/visualizers" not in path}  # of the blueprint


def test_rerun_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "out.rrd"
    assert write(path, [frame(0), frame(1)]) == [(), ()]
    assert [p.name for p in tmp_path.iterdir()] == ["out.rrd"]
    checked = rerun(tmp_path, "rrd", "verify", path)
    assert checked.returncode == 0, checked.stderr
    text = printed(tmp_path)
    leaves = ("", "/image", "/boxes", "/labels", "/objects")
    expected = {f"/world/cameras/{name}{leaf}" for name in ("left", "right") for leaf in leaves}
    world = "cloud ground objects headings faint placed uncertainty labels labels/lines numbers zones zones/counts"
    expected |= {"/world", *(f"/world/{name}" for name in world.split())}
    expected |= {"/world/lidars/lidar1", "/world/lidars/lidar2"}
    assert entities(text) == expected | {"/metrics/objects", "/metrics/confirmed", "/metrics/skew_ms"}
    assert "log_time" not in text
    assert "log_tick" not in text


def test_what_the_cameras_place_is_there_until_no_camera_looks(tmp_path: Path) -> None:
    sources = [Source.BOTH, Source.CAMERA, Source.LIDAR]
    write(tmp_path / "out.rrd", [frame(0, sources=sources), frame(1), frame(2)])
    assert "/world/detections/cameras/uncertainty" in entities(printed(tmp_path))
    assert not not_told(tmp_path, "both", "camera", "pedestrian 0.50 (1 cam, no lidar)", "lidcam.Objects:source")
    assert cleared(tmp_path) == {"/world/detections/cameras": 1}


def test_tracks_have_trails_and_those_that_are_predicted_a_path_of_their_own(tmp_path: Path) -> None:
    sources, tracks = [Source.BOTH, Source.PREDICTED, Source.PREDICTED], tracks_of([12, 7, 3], (0.0, 2.0))
    write(tmp_path / "out.rrd", [frame(index, sources=sources, tracks=tracks) for index in range(2)])
    paths = {"/world/uncertainty", "/world/trails", "/world/tracks/12", "/world/tracks/7"}
    assert paths <= entities(printed(tmp_path))
    texts = "car #12, 2.0 m/s", "pedestrian #7, 2.0 m/s (predicted)", "2.0 m/s, 7 km/h", "Scalars:scalars"
    assert not not_told(tmp_path, *texts)
    assert rows_of(tmp_path, "/world/trails") == 1  # there is none in the first frame


def test_a_track_that_ends_is_cleared_and_counts_in_the_properties(tmp_path: Path) -> None:
    write(tmp_path / "out.rrd", [frame(0, tracks=tracks_of([12, 7, 3], (0.0, 2.0))), frame(1, objects=0)])
    assert cleared(tmp_path) == {f"/world/tracks/{number}": 1 for number in (3, 7, 12)}
    assert not not_told(tmp_path, "1 car, 1 pedestrian, 1 ", "fastest_m_s", "road_users")


def test_recorded_video_is_logged_as_it_came(tmp_path: Path) -> None:
    parts = VideoPart("h264", (b"first", b"second")), VideoPart("h264", (b"third",)), VideoPart("mjpeg", (b"none",))
    bundles = [replace(frame(row).bundle, video={"/left/image": part}) for row, part in enumerate(parts)]
    write(tmp_path / "out.rrd", [replace(frame(row), bundle=bundle) for row, bundle in enumerate(bundles)])
    text = printed(tmp_path)
    found = re.findall(r"with (\d+) rows .* - /world/cameras/left/image - data columns: (.*)", text)
    assert sum(int(rows) for rows, columns in found if "VideoStream:sample" in columns) == 3
    assert sum(int(rows) for rows, columns in found if "EncodedImage:blob" in columns) == 1
    assert cleared(tmp_path) == {"/world/cameras/left/image": 1}
    assert "left: h264 video" in printed(tmp_path, "-vvv")


@pytest.mark.parametrize(
    ("frame_id", "drawn"), [("site", "/world/truth"), ("odom", "/world/fixed/truth"), ("other", "")]
)
def test_the_truth_that_is_nearest_is_drawn(tmp_path: Path, frame_id: str, drawn: str) -> None:
    one = frame(0, motion=True)
    stamp_ns, place = one.bundle.stamp_ns, np.zeros((1, 3))
    truth = tuple(
        TrueBoxes("/gt", stamp_ns + at, stamp_ns, frame_id, place, place + 1, np.zeros(1), (label,))
        for at, label in ((-9, "premature"), (4, "nearest"), (9, "tardy"))
    )
    write(tmp_path / "out.rrd", [replace(one, bundle=replace(one.bundle, truth=truth))])
    text = printed(tmp_path, "-vvv")
    assert {path for path in entities(text) if path.endswith("truth")} == ({drawn} if drawn else set())
    assert rows_of(tmp_path, "/legend/truth") == bool(drawn)
    assert ("nearest" in text) == bool(drawn)
    assert "premature" not in text
    assert "tardy" not in text


def test_equal_results_give_equal_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "one.rrd", [frame(0)])
    with monkeypatch.context() as patch:
        patch.setenv("RERUN", "off")
        patch.setenv("RERUN_FLUSH_NUM_BYTES", "no number")
        write(tmp_path / "two.rrd", [frame(0)])
    write(tmp_path / "other.rrd", [frame(0, objects=2)])
    assert rerun(tmp_path, "rrd", "compare", "--unordered", tmp_path / "one.rrd", tmp_path / "two.rrd").returncode == 0
    different = rerun(tmp_path, "rrd", "compare", "--unordered", tmp_path / "one.rrd", tmp_path / "other.rrd")
    assert different.returncode != 0


def test_warnings_drops_and_counts_of_zones_are_text(tmp_path: Path) -> None:
    summary = '{"warnings": [{"subject": "left", "finding": "no boxes", "remedy": "look there"}]}'
    provenance = replace(PROVENANCE, summary=lambda: summary)
    drop = Drop("/right/image", 1, "cannot be decoded", "12 bytes")
    write(tmp_path / "out.rrd", [frame(0), frame(1, objects=0, drops=(drop,))], provenance=provenance)
    assert not not_told(tmp_path, "left: no boxes; look there", "/right/image: cannot be decoded: 12 bytes")
    assert not not_told(tmp_path, "intersection: 2", "circle: 0", "intersection: 0")


def listed(batch: Any) -> Any:
    """The components of an archetype as an array."""
    return np.array(batch.as_arrow_array().to_pylist())


def test_large_clouds_are_thinned_evenly() -> None:
    xyz = np.random.default_rng(0).normal(0, 10, (2 * MAX_POINTS, 3)).astype(np.float32)
    places = listed(cloud_points(replace(frame().combined, cloud=point_cloud(xyz)), (0.0, 1.0)).positions)
    assert 0.95 * MAX_POINTS < len(places) <= MAX_POINTS
    np.testing.assert_array_equal(places[[0, -1]], xyz[[0, -1]])


def test_frames_without_anything_to_show(tmp_path: Path) -> None:
    result = frame(objects=0)
    detections, hypotheses = replace(result.detections, cameras={}), replace(result.hypotheses, matches={})
    lidars = {topic: m for topic, m in result.bundle.messages.items() if "lidar" in topic}
    empty = replace(result, combined=combined(), detections=detections, hypotheses=hypotheses)
    write(tmp_path / "out.rrd", [replace(empty, bundle=replace(empty.bundle, messages=lidars))])
    assert rerun(tmp_path, "rrd", "verify", tmp_path / "out.rrd").returncode == 0


def without_left(result: FrameResult, why: Missing) -> FrameResult:
    """The frame without the left camera's image and boxes."""
    kept = {topic: m for topic, m in result.bundle.messages.items() if topic != "/left/image"}
    cameras = {name: boxes for name, boxes in result.detections.cameras.items() if name != "left"}
    bundle = replace(result.bundle, messages=kept, missing={"/left/image": why})
    return replace(result, bundle=bundle, detections=replace(result.detections, cameras=cameras))


@pytest.mark.parametrize("is_whole", [True, False])
def test_an_unreadable_image_is_reported_unless_it_is_left_out(tmp_path: Path, is_whole: bool) -> None:
    config = Config.model_validate({"output": {"images": is_whole, "clouds": is_whole}})
    drop = Drop("/left/image", START_NS + 1_000_001, "the image cannot be shown", "/left/image: no image")
    assert write(tmp_path / "out.rrd", [frame()], config=config, decode=unreadable) == [(drop,) * is_whole]
    assert ("/world/cloud" in entities(printed(tmp_path))) == is_whole


def cleared(tmp_path: Path) -> dict[str, int]:
    """How often each entity of `out.rrd` is cleared."""
    found = re.findall(r"with (\d+) rows .* - (/[\w/]+) - data columns: .*@Clear:", printed(tmp_path))
    return {path: sum(int(rows) for rows, other in found if other == path) for _, path in found}


@pytest.mark.parametrize("moves", [True, False])
def test_a_moving_rig_has_a_fixed_frame_and_a_way(tmp_path: Path, moves: bool) -> None:
    write(tmp_path / "out.rrd", [frame(index, motion=moves) for index in range(3)])
    assert ({"/world/fixed", "/world/fixed/way"} <= entities(printed(tmp_path))) == moves
    assert rows_of(tmp_path, "/legend/own") == moves


@pytest.mark.parametrize(
    ("why", "leaves"), [(Missing.NOT_NEAR, ()), (Missing.SILENT, ("image", "boxes", "labels", "objects"))]
)
def test_the_image_of_a_slow_camera_stays_and_that_of_a_silent_one_is_cleared_once(
    tmp_path: Path, why: Missing, leaves: tuple[str, ...]
) -> None:
    write(tmp_path / "out.rrd", [frame(0), *(without_left(frame(row), why) for row in (1, 2, 3))])
    assert cleared(tmp_path) == {f"/world/cameras/left/{leaf}": 1 for leaf in leaves}


def test_boxes_go_on_where_only_the_image_is_slow(tmp_path: Path) -> None:
    slow = without_left(frame(1), Missing.NOT_NEAR)
    detections = replace(slow.detections, cameras=frame(1).detections.cameras)
    write(tmp_path / "out.rrd", [frame(0), replace(slow, detections=detections)])
    assert cleared(tmp_path) == {}
    assert rows_of(tmp_path, "/world/cameras/left/image") == 1


def rows_of(tmp_path: Path, entity: str) -> int:
    """How often an entity was logged."""
    return sum(map(int, re.findall(rf"with (\d+) rows .* - {entity} - data columns", printed(tmp_path))))


def test_that_nothing_is_drawn_is_logged_once(tmp_path: Path) -> None:
    counts = (0, 0, 3, 3, 0, 0, 3)
    write(tmp_path / "out.rrd", [frame(row, objects=count) for row, count in enumerate(counts)])
    assert rows_of(tmp_path, "/world/objects") == 1 + 2 + 1 + 1
    assert rows_of(tmp_path, "/metrics/skew_ms") == 1 + len(counts)  # with its colour


def test_heights_have_colours_from_low_to_high() -> None:
    xyz = np.zeros((6, 3), np.float32)
    xyz[:, 2] = [-5.0, 0.0, 0.25, 0.5, 1.0, 9.0]
    packed = listed(cloud_points(replace(frame().combined, cloud=point_cloud(xyz)), (0.0, 1.0)).colors)
    rgb = np.stack([packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255], -1)
    np.testing.assert_array_equal(rgb[[0, 1]], [[62, 84, 128]] * 2)
    np.testing.assert_array_equal(rgb[[4, 5]], [[245, 240, 225]] * 2)
    np.testing.assert_allclose(rgb[2], [62 + 0.75 * 46, 84 + 0.75 * 66, 128 + 0.75 * 62], atol=1)
    np.testing.assert_allclose(rgb[3], [142, 177.5, 204], atol=1)
    assert (packed & 255 == 255).all()


def test_labels_never_cover_each_other_nor_leave_the_image() -> None:
    camera = RIG.cameras[0]
    xyxy = np.array([[0, 0, 30, 60], [5, 5, 36, 61], [300, 200, 420, 479], [300, 300, 310, 303]], np.float32)
    drawn = DrawnBoxes2D(xyxy, [MATCHED] * 4, ["truck 0.90", "car 0.80", "bus 0.70", "car 0.60"])
    labels = labels_2d(drawn, camera, 350.0)
    assert listed(labels.labels).tolist() == ["bus 0.70", "truck 0.90"]
    places = listed(labels.positions)
    assert ((places > 0) & (places < [640, 480 - 20])).all()


def test_where_the_motion_is_not_known_the_way_is_hidden(tmp_path: Path) -> None:
    lost = frame(1, motion=True)
    motion = lost.bundle.motion
    assert motion is not None
    alone = replace(motion, stamps_ns=motion.stamps_ns[:1], T_fixed_moving=motion.T_fixed_moving[:1])
    write(tmp_path / "out.rrd", [frame(0, motion=True), replace(lost, bundle=replace(lost.bundle, motion=alone))])
    assert re.search(r"/world/fixed - data columns: .*Transform3D:scale", printed(tmp_path))
    assert rows_of(tmp_path, "/world/fixed/way") == 1


def test_an_image_that_was_dropped_is_not_shown(tmp_path: Path) -> None:
    dropped = Drop("/left/image", START_NS + 1_000_001, "cannot be decoded")
    write(tmp_path / "out.rrd", [frame(drops=(dropped,))])
    text = printed(tmp_path)
    assert "/world/cameras/left/image@EncodedImage:blob" not in text
    assert "/world/cameras/right/image@EncodedImage:blob" in text


def test_the_eye_is_placed_once_in_a_long_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.writers.rerun.writer.MAX_WAITING_FRAMES", 5)
    write(tmp_path / "out.rrd", [frame(row) for row in range(SURVEYED_FRAMES + 2)])
    assert printed(tmp_path).count("EyeControls3D:position") == 2  # of the scene, and from above
