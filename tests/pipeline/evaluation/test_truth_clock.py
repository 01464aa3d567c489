"""An offset of the truth's clock is found from objects that move."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from evaluation_frames import frame_of, source_boxes, truth_boxes

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.truth_clock import TruthClock


@pytest.mark.parametrize(
    ("offset_s", "speed_m_s", "known_ms", "found", "told_s"),
    [
        (0.0, 8.0, 0, "all", None),
        (0.1, 8.0, 0, "all", 0.1),
        (-0.5, 8.0, 0, "all", -0.5),
        (2.0, 8.0, 250, "all", 2.25),
        (1.0, 0.0, 0, "all", None),
        (0.05, 8.0, 0, "all", None),
        (1.0, 8.0, 0, "few", None),
        (1.0, 8.0, 0, "none", None),
    ],
)
def test_an_offset_of_the_clock(
    offset_s: float, speed_m_s: float, known_ms: float, found: Literal["all", "few", "none"], told_s: float | None
) -> None:
    """Two cars drive towards one another, and one stands; all are found 0.2 m too near."""
    clock = TruthClock(Config(evaluate=EvaluateConfig(truth_offset_ms=known_ms)))

    def rows(time_s: float, shift_m: float = 0.0) -> list[list[float]]:
        way_m = speed_m_s * time_s - shift_m
        return [[x, y, 0.8, 4, 1.7, 1.5, yaw] for x, y, yaw in ((way_m, 0, 0), (60 - way_m, 4, np.pi), (20, 8, 0))]

    for k in range(40):
        is_found = found == "all" or (found == "few" and k % 5 == 0)
        source = source_boxes(rows(k / 10, 0.2) if is_found else [])
        frame = frame_of(k, truth_boxes(rows(k / 10 - offset_s), [1, 2, 3]), {"fused": source})
        clock.add_frame(replace(frame, T_fixed_site=np.eye(4)))
    assert clock.figures() == {"truth_offset_s": None if told_s is None else pytest.approx(told_s, abs=0.051)}
    assert TruthClock(Config()).figures() == {"truth_offset_s": None}
