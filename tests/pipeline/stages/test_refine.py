from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from fusion_scenes import FusionScene, fusion_scenes
from scipy.stats import chi2

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D, Hypotheses
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.core.settings.fuse import FuseConfig
from pipeline.stages.associate import Associate
from pipeline.stages.refine import Refine

EXACT_CUBOIDS = {"size_sigma": 0.0, "corner_rounding": 0.0, "underside": 0.0, "cabin": 0.0, "outline_sigma": 0.0}


def errors(boxes: Boxes3D, truth: Boxes3D) -> F64:
    """(N, 3) of x, y, yaw."""
    return np.column_stack([boxes.centers[:, :2] - truth.centers[:, :2], wrap_angle(boxes.yaws - truth.yaws)])


def refined(rig: Rig, scene: FusionScene, settings: Mapping[str, Any]) -> Boxes3D:
    views = {camera.name: camera for camera in rig.cameras}
    matches = Associate(rig, Config())(scene.lidar, scene.seen, views)
    hypotheses = Hypotheses(scene.lidar, matches, len(scene.lidar))
    config = Config(fuse=FuseConfig.model_validate({**EXACT_CUBOIDS, **settings}))
    return Refine(rig, config)(hypotheses, scene.seen, views).boxes


def test_scenes_of_the_original() -> None:
    # What is given: the noise of the lidar's boxes, as a calibrated detector tells it; cuboids of known
    # size. One pixel noise for all scenes.
    rig, scenes = fusion_scenes()
    by_noise: dict[float, list[F64]] = {}
    for scene in scenes:
        found = refined(rig, scene, {"pixel_sigma_px": 3.0})
        before, after = errors(scene.lidar, scene.truth), errors(found, scene.truth)
        squared = np.einsum("ni,nij,nj->n", after, np.linalg.inv(found.covariances), after)
        table = np.column_stack([*(f(e) for e in (before, after) for f in (place, heading)), squared])
        by_noise.setdefault(scene.position_noise_m + scene.pixel_noise_px, []).append(table[scene.judged])
    tables = [np.concatenate(rows) for rows in by_noise.values() if sum(map(len, rows))]
    everything = np.concatenate(tables)
    assert everything.shape == (139, 5)
    assert everything.mean(0)[:4] == pytest.approx([0.083, 0.172, 0.029, 0.090], abs=6e-4)
    for table in tables:
        assert table[:, 2].mean() <= table[:, 0].mean()
        assert table[:, 3].mean() <= table[:, 1].mean()


def test_covariances_of_the_scenes_are_honest() -> None:
    rig, scenes = fusion_scenes()
    squared: list[float] = []
    for scene in scenes:
        if scene.judged.any():
            found = refined(rig, scene, {"pixel_sigma_px": scene.pixel_noise_px})
            error = errors(found, scene.truth)
            squared.extend(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariances), error)[scene.judged])
    low, high = (float(chi2.ppf(share, 3 * len(squared))) / len(squared) for share in (0.025, 0.975))
    assert low <= float(np.mean(squared)) <= high


def place(error: F64) -> F64:
    return np.hypot(error[:, 0], error[:, 1])


def heading(error: F64) -> F64:
    return np.abs(error[:, 2])
