"""Labelled frames: what is known, objects in free places, other sides."""

# without torch the file is skipped before it imports what needs it

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra train")

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.detectors.cluster.network import ClusterNetwork
from lidcam.training import clusters
from lidcam.training.clusters import train_clusters
from lidcam.training.examples import examples_of_frame
from lidcam.training.labelled import LabelledFrame, Objects, Recordings, TrueBoxes, points_in_boxes, saved
from lidcam.training.pillars.scenes import UNLABELLED, known_to, targets_of_frame

CAR = 4.0, 1.8, 1.5


def boxes(*rows: tuple[float, float, float, int]) -> TrueBoxes:
    """Cars of x, y, yaw and a class."""
    x, y, yaws, classes = np.array(rows, np.float64).reshape(-1, 4).T
    sizes = np.tile(CAR, (len(x), 1))
    points = np.full(len(x), 200)
    return TrueBoxes(np.column_stack([x, y, np.full(len(x), 0.75)]), sizes, yaws, classes.astype(np.int64), points)


def points_on(true: TrueBoxes) -> F64:
    """Points on the two near sides of cars of yaw 0, as a lidar at the origin sees them."""
    along, across = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(0.3, 1.4, 8))
    rear = np.stack([np.full(along.shape, -2.0), 0.9 * along, across], -1).reshape(-1, 3)
    side = np.stack([2 * along, np.full(along.shape, -0.9), across], -1).reshape(-1, 3)
    ground = np.column_stack([true.centers[:, :2], np.zeros(len(true.yaws))])
    found: F64 = ground[:, None] + np.concatenate([rear, side])
    return found.reshape(-1, 3)


def frame(points: TrueBoxes, true: TrueBoxes) -> LabelledFrame:
    """Labelled in front up to 40 m, but for 3 m around (20, -8)."""
    position, front = points_on(points), np.array([[0, -50], [50, -50], [50, 50], [0, 50.0]])
    lidar = np.zeros(len(position), np.uint8)
    reach, unlabelled = np.array([0, 0, 40.0]), np.array([[20, -8, 3.0]])
    return LabelledFrame(position, lidar, np.array([[0, 0, 1.7]]), true, unlabelled, front, reach)


ALL = boxes((10, 5, 0, 0), (20, 3, 0, 0), (20, -8, 0, 0), (-15, 4, 0, 0), (30, 30, 0, 0))
"""Labelled, not an object, unlabelled, and two beyond what is labelled."""

FRAME = frame(ALL, boxes((10, 5, 0, 0)))


def test_what_is_not_labelled_is_not_learned_by_clusters() -> None:
    assert FRAME.is_labelled(ALL.centers[:, :2]).tolist() == [True, True, False, False, False]
    assert sorted(examples_of_frame(FRAME).kinds.tolist()) == [0, 1]
    assert len(examples_of_frame(FRAME._replace(reach=np.array([0, 0, 1.0]), true=boxes())).kinds) == 0


def test_what_is_not_labelled_is_not_learned_by_pillars() -> None:
    heat = targets_of_frame("road", FRAME).heat
    at = np.floor((ALL.centers[:, :2] + 0.32 * 128) / 0.64).astype(np.int64)
    assert heat[0, at[:, 1], at[:, 0]].tolist() == pytest.approx([1, 0, UNLABELLED, UNLABELLED, UNLABELLED])
    assert (heat == 1).sum() == 1


def test_clusters_of_frames_alone_are_learned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "EPOCHS", 2)
    path, none = saved(tmp_path / "a", FRAME), saved(tmp_path / "b", Objects(boxes(), [], []))
    recordings = Recordings((path,), (path,), (path,), none, ("a.mcap, SHA-256\n  abc",))
    shares: list[float] = []

    def trained() -> tuple[ClusterNetwork, str]:
        return train_clusters(
            None, 3, 0, workers=1, progress=lambda share, _: shares.append(share), recordings=recordings
        )

    network, card = trained()
    assert "lidcam train clusters --recordings RECORDING \\\n      --worlds 3 --seed 0 --out FILE.npz" in card
    assert "from 24 boxes of clusters in:\n\n- recordings\n  a.mcap, SHA-256\n  abc\n  (1 frames" in card
    assert "drawn worlds" not in card
    assert network.to_bytes() == trained()[0].to_bytes()
    assert shares == [*sorted(shares[: len(shares) // 2])] * 2


@pytest.mark.parametrize("bare", ["learn from", "calibrate with"])
@pytest.mark.parametrize("region_m", [1.0, 40.0], ids=["nothing is known", "all is background"])
def test_clusters_are_not_learned_without_objects(tmp_path: Path, bare: str, region_m: float) -> None:
    without = FRAME._replace(reach=np.array([0, 0, region_m]), true=boxes())
    full, empty = saved(tmp_path / "full", FRAME), saved(tmp_path / "empty", without)
    train, calibrate = (empty, full) if bare == "learn from" else (full, empty)
    recordings = Recordings((train,), (calibrate,), (full,), saved(tmp_path / "c", Objects(boxes(), [], [])), ("a",))
    with pytest.raises(RecordingError, match=f"expected labelled objects .* found none in the frames to {bare}"):
        train_clusters(None, 1, 0, workers=1, progress=lambda *_: None, recordings=recordings)


def test_objects_are_put_where_nothing_is() -> None:
    true = boxes((12, 0, 0, 0), (25, 0, 0, 3))
    position = points_on(true).astype(np.float32)
    objects = Objects(true, [position[:320], position[320:]], [np.full(320, 3, np.uint8)] * 2)
    draw, put = np.random.default_rng(0), []
    for _ in range(20):
        found = FRAME.with_objects(objects, draw)
        new = found.true.select(np.arange(1, len(found.true.yaws)))
        put.append(new)
        assert found.is_labelled(new.centers[:, :2]).all()
        _, box = points_in_boxes(found.position, found.true)
        assert np.bincount(box).tolist() == [320] * len(found.true.yaws)  # its own, and none of another
        assert found.lidar.max() == 0
    every = TrueBoxes.joined(put)
    away_m = np.linalg.norm(every.centers[:, :2], axis=1)
    np.testing.assert_allclose(away_m, np.where(every.classes == 3, 25, 12))
    assert min(np.bincount(every.classes, minlength=4)[[0, 3]]) > 10
    none = Objects(boxes(), [], [])
    assert FRAME.with_objects(none, draw) is FRAME


def test_all_of_a_frame_is_seen_from_another_side() -> None:
    before = FRAME.is_labelled(ALL.centers[:, :2])
    for seed in range(10):
        draw = np.random.default_rng(seed)
        found, moved = FRAME.varied(draw), FRAME._replace(true=ALL).varied(np.random.default_rng(seed)).true
        _, box = points_in_boxes(found.position, found.true)
        assert len(box) == 320
        assert found.is_labelled(moved.centers[:, :2]).tolist() == before.tolist()
    assert len(known_to("sandbox", FRAME._replace(true=boxes((10, 5, 0, 3)))).yaws) == 0
