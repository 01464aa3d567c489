"""Clouds of objects, read back by Open3D."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from frames import CONFIG, PERIOD_NS, START_NS
from tracked_frames import Seen, tracked_frame

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.settings.run import OutputConfig
from lidcam.writers.clouds.writer import ObjectCloudsWriter
from lidcam.writers.outputs.transaction import OutputFile

NAMES = ("car", "a b/c")


def seen_by_lidars(index: int, *seen: Seen, tracked: bool = True) -> FrameResult:
    """A frame whose objects have 60 points each inside of their boxes, in other places each time."""
    frame = tracked_frame(index, *seen, is_tracked=tracked)
    random = np.random.default_rng(index)
    places = [random.uniform(-0.6, 0.6, (60, 3)) + np.array([one.x, one.y, 0.5]) for one in seen]
    xyz = np.concatenate([np.zeros((0, 3)), *places]).astype(np.float32)
    intensity, zeros = np.arange(len(xyz), dtype=np.float32), np.zeros(len(xyz), np.uint16)
    offsets_ns = np.full(len(xyz), -25_000_000, np.int32)
    stamp_ns = frame.bundle.stamp_ns
    points = PointCloud(stamp_ns, "site", xyz, intensity, zeros, offsets_ns, has_time=True)
    lidars = np.zeros(len(xyz), np.uint8)
    combined = replace(frame.combined, detection_cloud=points, detection_lidar_index=lidars)
    return replace(frame, combined=combined)


FRAMES = [
    seen_by_lidars(0, Seen(1, 0, 0), Seen(20_000, 9, 0)),
    seen_by_lidars(1, Seen(1, 1, 0, 10.0)),
    seen_by_lidars(2, Seen(7, -5, 0), Seen(1, 2, 0, 10.0, class_id=1), Seen(0, 0, 9)),
    seen_by_lidars(3),
    seen_by_lidars(90, Seen(7, -5, 0), Seen(1, 3, 0, 10.0, class_id=1)),
]


def written(path: Path, frames: Iterable[FrameResult], config: OutputConfig = CONFIG.output) -> dict[str, bytes]:
    """The content of the files that are written, by name."""
    with ObjectCloudsWriter(OutputFile(path, path), NAMES, config) as writer:
        for one in frames:
            assert writer.write(one) == ()
    return {file.name: file.read_bytes() for file in sorted(path.iterdir())}


@pytest.mark.parametrize("frames", [[], [seen_by_lidars(0, Seen(1, 0, 0), tracked=False)], FRAMES[3:4]])
def test_without_tracked_objects_the_folder_is_empty(tmp_path: Path, frames: list[FrameResult]) -> None:
    assert written(tmp_path / "clouds", frames) == {}


def test_every_object_has_a_file_under_its_last_class(tmp_path: Path) -> None:
    files = written(tmp_path / "clouds", FRAMES)
    assert [*files] == ["track_0001_a_b_c.pcd", "track_0007_car.pcd", "track_20000_car.pcd"]
    counts = []
    for name in files:
        found = o3d.t.io.read_point_cloud(tmp_path / "clouds" / name)
        assert np.abs(found.point.positions.numpy()).max() < 1.15
        counts.append(len(found.point.positions))
        seconds = np.unique(found.point.time.numpy())
        expected = {"1": [0, 0.1, 0.2, 9.0], "7": [0, 8.8], "20000": [0]}[name.split("_")[1].lstrip("0")]
        np.testing.assert_allclose(seconds, np.array(expected) - 0.025, atol=1e-6)
        assert set(found.point.intensity.numpy().ravel()) <= set(range(180))
    assert 230 < counts[0] <= 240
    assert (110 < counts[1] <= 120, counts[2]) == (True, 60)


@pytest.mark.parametrize("most", [1, 200])
def test_clouds_that_wait_in_their_files_become_the_same(tmp_path: Path, most: int) -> None:
    bounded = OutputConfig(waiting_cloud_points=most)
    files = written(tmp_path / "bounded", FRAMES, bounded)
    assert files == written(tmp_path / "free", FRAMES)
    assert b'"stamp_ns": %d' % (START_NS + 2 * PERIOD_NS) in files["track_0007_car.pcd"]


def test_a_folder_that_has_gone_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "clouds"

    def leaving() -> Iterator[FrameResult]:
        yield FRAMES[0]
        path.rmdir()

    with pytest.raises(OutputError, match="clouds: cannot be written: No such file"):
        written(path, leaving())
