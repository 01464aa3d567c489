"""Labelled recordings as what is learned from."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from detections import boxes3d
from helpers import CLUSTERS, SANDBOX

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, Motion, ResultFrame, SourceBoxes
from lidcam.training import recordings
from lidcam.training.labelled import Recordings, loaded
from lidcam.training.pillars import scenes
from lidcam.training.pillars.scenes import Source, rounds
from lidcam.training.recordings import read_recordings, tracked_objects


def read(folder: Path, *settings: str, duration_s: float | None = None, own_labels: bool = False) -> Recordings:
    folder.mkdir()
    return read_recordings(
        [str(SANDBOX)],
        folder,
        check=lambda _: None,
        progress=lambda *_: None,
        settings=settings,
        workers=1,
        duration_s=duration_s,
        own_labels=own_labels,
    )


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    """Two seconds of the sandbox."""
    return read(tmp_path_factory.mktemp("frames") / "a", "evaluate.region=[[-9,-9],[9,-9],[9,9],[-9,1]]", CLUSTERS)


def test_frames_have_their_points_and_objects_and_some_are_kept_apart(sandbox: Recordings) -> None:
    train, calibrate, judge = ([int(path.stem) for path in part] for part in sandbox[:3])
    assert [*train, *calibrate, *judge] == sorted({*train, *calibrate, *judge})
    assert len(calibrate) == len(judge) == 2
    assert calibrate[0] - train[-1] == 5  # half a second
    for path in (*sandbox.train, *sandbox.judge):
        frame = loaded(path)
        assert frame.true.classes.tolist() == [0, 0]
        assert (frame.true.points > 20).all()
        np.testing.assert_allclose(frame.true.centers[:, 2], frame.true.sizes[:, 2] / 2, atol=0.03)
        assert frame.origins.shape == (3, 3)
        assert frame.is_labelled(np.array([[0, 0], [-8.9, 8.0]])).tolist() == [True, False]
    assert "sandbox.bag, SHA-256\n" in sandbox.text
    assert {path.suffix for path in sandbox.train[0].parent.iterdir()}.isdisjoint({".cloud", ".mcap"})


def test_sure_tracks_stand_in_for_truth(tmp_path: Path, sandbox: Recordings) -> None:
    """The boxes of the tracks of both model cars are near the true ones; without truth in the recording."""
    own = read(tmp_path / "a", "output.copy_topics=[]", own_labels=True)
    assert [path.stem for path in own.train] == [path.stem for path in sandbox.train]
    for one, other in zip(own.train, sandbox.train, strict=True):
        found, true = loaded(one).true, loaded(other).true
        order = np.linalg.norm(found.centers[:, None] - true.centers, axis=2).argmin(0)
        assert sorted(order.tolist()) == [0, 1]
        np.testing.assert_allclose(found.centers[order], true.centers, atol=0.03)
        np.testing.assert_allclose(found.sizes[order], true.sizes, atol=0.05)
        np.testing.assert_array_equal(found.points[order] > 20, [True, True])


@pytest.mark.parametrize(
    ("score", "seen", "track", "is_sure"),
    [(0.95, 5, 1, True), (0.85, 5, 1, False), (0.95, 4, 1, False), (0.95, 5, UNKNOWN, False)],
    ids=["sure", "doubted", "seen too briefly", "without a track"],
)
def test_what_makes_a_track_sure(score: float, seen: int, track: int, is_sure: bool) -> None:
    """A box of the lidars of which nothing is reported is background."""
    lidar = boxes3d([[0, 0, 0, 4, 2, 1.5, 0], [20, 0, 0, 4, 2, 1.5, 0]], scores=[0.9, 0.4])
    fused = boxes3d([[0, 0, 0, 4, 2, 1.5, 0]], scores=[score])
    frames = []
    for index in range(7):
        motion = Motion(np.zeros((1, 2)), np.zeros(1), np.array([index >= seen]), np.ones(1, np.bool_))
        sources = {
            "lidar": SourceBoxes(lidar, np.full(2, UNKNOWN)),
            "fused": SourceBoxes(fused, np.array([track]), motion),
        }
        frames.append(ResultFrame(index, index, index, sources, {}))
    for index, (number, truth) in enumerate(tracked_objects(lambda: frames)):
        assert number == index
        assert truth.is_ignored.tolist() == [not is_sure]
        assert truth.centers[:, 0].tolist() == [0]


@pytest.mark.slow
def test_of_many_frames_some_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "MAX_FRAMES", 6)
    monkeypatch.setattr(recordings, "MIN_FRAMES", 3)
    monkeypatch.setattr(recordings, "GAP_NS", 0)
    some = read(tmp_path / "a", CLUSTERS)
    assert [int(path.stem) for part in some[:3] for path in part] == [0, 4, 8, 12, 16]


def test_scenes_are_the_same_for_any_number_of_workers(sandbox: Recordings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "WORLDS_OF_A_ROUND", 2)
    monkeypatch.setattr(scenes, "process_pool", ThreadPoolExecutor)  # processes take seconds to begin
    alone, again = [[*rounds(Source("sandbox", sandbox, False), 0, 0, 3, workers)] for workers in (1, 2)]
    assert [len(part) for part in alone] == [16] * 3
    for part, same_part in zip(alone, again, strict=True):
        for one, other in zip(part, same_part, strict=True):
            for first, second in zip((*one[:2], *one.targets), (*other[:2], *other.targets), strict=True):
                np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("settings", "duration_s", "message"),
    [
        (["output.copy_topics=[]"], 0.3, r"sandbox.bag: expected topics of truth to learn from, found none$"),
        ([], 0.5, r"expected a recording of 10 labelled frames or more, .* found [345] in all, .* and 0 kept apart"),
        ([], 1.2, r"the last fifth is kept apart, and a gap of 1 s .* found 1[01] in all, 0 to learn from and 2 kept"),
    ],
)
def test_recordings_that_do_not_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: list[str], duration_s: float, message: str
) -> None:
    monkeypatch.setattr(recordings, "GAP_NS", 1_000_000_000)
    with pytest.raises(RecordingError, match=message):
        read(tmp_path / "a", CLUSTERS, *settings, duration_s=duration_s)


def test_a_recording_with_nothing_to_learn_from(tmp_path: Path) -> None:
    expected = r"sandbox.bag: nothing to learn from: expected 20 boxes .* found 0 in 12 frames; keep the network"
    with pytest.raises(RecordingError, match=expected):
        read(tmp_path / "a", CLUSTERS, "combine.max_range_m=0.5", own_labels=True)
