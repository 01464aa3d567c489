"""Odometry with a box of the rig file is the same truth as the simulator's objects, and travels with the result."""

from pathlib import Path

import numpy as np
from helpers import SANDBOX

import lidcam
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.readers.results.result import open_result
from lidcam.readers.rig.schema import parse_rig
from lidcam.readers.truth.open import open_truth

TRUTH = {
    name: {"topic": f"/{name}/base_pose_ground_truth", "size_m": [0.33, 0.22, 0.21], "class": "car"}
    for name in ("car1", "car2")
}


def test_it_agrees_with_the_simulators_objects(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    rig = parse_rig({"truth": TRUTH}, Path("rig.yaml"))
    settings = {"output.images": False, "output.clouds": False, "output.layout": False}
    summary = lidcam.process(
        SANDBOX, out, config="sandbox", rig=rig, settings=settings, start_s=0.5, duration_s=0.6
    ).summary
    assert {*summary.inputs.copied} >= {"/ground_truth/objects", *(entry["topic"] for entry in TRUTH.values())}
    with (
        open_result(out) as opened,
        open_truth(opened) as of_odometry,
        open_result(out) as again,
        open_truth(again, topic="/ground_truth/objects") as of_topic,
    ):
        assert {*opened.rig.truth} == {*TRUTH}
        pairs = list(zip(EvaluationFrames(opened, of_odometry), EvaluationFrames(again, of_topic), strict=True))
    assert len(pairs) >= 5
    for first, second in pairs:
        assert first.truth is not None
        assert second.truth is not None
        order = np.argsort(second.truth.centers[:, 0])
        mine = np.argsort(first.truth.centers[:, 0])
        np.testing.assert_allclose(first.truth.centers[mine], second.truth.centers[order], atol=0.005)
        turn = first.truth.yaws[mine] - second.truth.yaws[order]
        np.testing.assert_allclose(np.sin(turn), 0, atol=0.02)
        assert (np.cos(turn) > 0).all()
        assert first.truth.labels.tolist() == second.truth.labels.tolist() == ["car", "car"]
