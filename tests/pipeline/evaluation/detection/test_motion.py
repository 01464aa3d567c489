"""Covariances, velocities and predictions of detections against truth that is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evaluation_frames import evaluated, frame_of, source_boxes, truth_boxes
from scipy.stats import multivariate_normal

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Motion, SourceBoxes

SIZE_M = (4.0, 1.7, 1.5)
CONFIG = Config()


def car(x: float, y: float = 0.0, yaw: float = 0.0) -> list[float]:
    return [x, y, 0.8, *SIZE_M, yaw]


def figures(frames: list[EvaluationFrame], config: Config = CONFIG, name: str = "car") -> Any:
    return evaluated(frames, config)["sources"]["fused"][name]


def moving(source: SourceBoxes, velocity: Any, yaw_rate: Any = 0.0, predicted: Any = False) -> SourceBoxes:
    """The same boxes, with one motion for all."""
    n = len(source)
    rows = (
        np.tile(np.array(velocity, np.float64), (n, 1)),
        np.full(n, float(yaw_rate)),
        np.full(n, predicted),
        np.ones(n, np.bool_),
    )
    return replace(source, motion=Motion(*rows))


def test_errors_drawn_from_their_covariance_are_normalised() -> None:
    """Their mean is what scipy says by the logarithm of the density, and that of chi-square, as is the share inside."""
    rng = np.random.default_rng(3)
    root = rng.normal(0, 0.1, (3, 3))
    covariance = root @ root.T + 1e-4 * np.eye(3)
    errors = rng.multivariate_normal(np.zeros(3), covariance, 2000)
    rows = [car(30.0 * k, 0, 0.5) for k in range(100)]
    truth, found = truth_boxes(rows), source_boxes(rows)
    frames = []
    for k, drawn in enumerate(errors.reshape(20, 100, 3)):
        moved = np.column_stack([drawn[:, :2], np.zeros(100)])
        boxes = replace(
            found.boxes,
            centers=truth.centers + moved,
            yaws=wrap_angle(truth.yaws + drawn[:, 2] + k % 2 * np.pi),  # in every other frame turned round
            covariances=np.tile(covariance, (100, 1, 1)),
        )
        frames.append(frame_of(k, truth, {"fused": replace(found, boxes=boxes)}))
    told = figures(frames)["errors"]["nees"]
    density = multivariate_normal(np.zeros(2), covariance[:2, :2])
    expected = -2 * density.logpdf(errors[:, :2]) - 2 * np.log(2 * np.pi) - np.linalg.slogdet(covariance[:2, :2])[1]
    assert told["count"] == len(errors)
    assert told["mean"] == pytest.approx(expected.mean(), rel=1e-4)
    assert told["mean"] == pytest.approx(2, rel=0.1)
    assert told["inside_95"] == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    "covariance",
    [
        np.zeros((3, 3)),
        np.diag([1.0, -1.0, 1.0]),
        np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        np.diag([1.0, np.nan, 1.0]),
        np.diag([1.0, 1e300, 1.0]),
        np.diag([1e11, 1e-11, 1.0]),
    ],
    ids=["none", "negative", "flat", "not a number", "overflow", "a needle"],
)
def test_covariances_that_say_nothing_do_not_count(covariance: F64) -> None:
    found = source_boxes([car(0.1), car(30.1)])
    covariances = np.array([covariance, np.diag([0.01, 0.01, 0.01])])
    boxes = replace(found.boxes, covariances=covariances)
    told = figures([frame_of(0, truth_boxes([car(0), car(30)]), {"fused": replace(found, boxes=boxes)})])["errors"]
    assert told["nees"] == {"count": 1, "mean": pytest.approx(1), "inside_95": 1}


def drive(count: int = 6, *, speed: float = 5.0, turn: float = 0.0, **motion: Any) -> list[EvaluationFrame]:
    """A car that drives along x, found where it is, seen from a site that turns on the spot."""
    frames = []
    for k in range(count):
        yaw, x = turn * k / 10, 10 + speed * k / 10
        c, s = np.cos(yaw), np.sin(yaw)
        row = car(c * x, -s * x, -yaw)
        site = np.eye(4)
        site[:2, :2] = [[c, -s], [s, c]]
        velocity = np.array([[c, s], [-s, c]]) @ motion.get("velocity", (speed, 0.0))
        found = moving(source_boxes([row], [3]), velocity, motion.get("yaw_rate", 0.0), motion.get("predicted", False))
        frames.append(replace(frame_of(k, truth_boxes([row], [7]), {"fused": found}), T_fixed_site=site))
    return frames


@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_velocities_are_over_the_ground(turn: float) -> None:
    right = figures(drive(turn=turn))["errors"]
    assert (right["velocity_m_s"]["count"], right["yaw_rate_deg_s"]["count"]) == (4, 4)  # not of the first and last
    assert right["velocity_m_s"]["max"] == pytest.approx(0, abs=1e-5)
    assert right["yaw_rate_deg_s"]["max"] == pytest.approx(0, abs=1e-4)
    wrong = figures(drive(turn=turn, velocity=(2.0, 4.0), yaw_rate=-0.5))["errors"]
    assert wrong["velocity_m_s"]["rmse"] == pytest.approx(5, rel=1e-5)
    assert wrong["yaw_rate_deg_s"]["bias"] == pytest.approx(np.degrees(-0.5), rel=1e-5)


def test_velocities_that_cannot_be_compared() -> None:
    def counted(frames: list[EvaluationFrame], config: Config = CONFIG) -> tuple[int, int]:
        errors = figures(frames, config)["errors"]
        assert errors["velocity_m_s"]["rmse"] is None
        return errors["velocity_m_s"]["count"], errors["yaw_rate_deg_s"]["count"]

    frames = drive()
    sources = [frame.sources["fused"] for frame in frames]
    without = [replace(f, sources={"fused": replace(s, motion=None)}) for f, s in zip(frames, sources, strict=True)]
    assert counted(without) == (0, 0)
    assert counted([replace(frame, T_fixed_site=None) for frame in frames]) == (0, 0)
    places = [source.boxes.centers[0].tolist() for source in sources]
    nameless = [replace(f, truth=truth_boxes([[*xyz, *SIZE_M, 0]])) for f, xyz in zip(frames, places, strict=True)]
    assert counted(nameless) == (0, 0)
    at_points = Config(evaluate=EvaluateConfig(truth_time="points"))
    assert counted(frames, at_points) == (0, 0)


def test_flips_of_what_moves() -> None:
    frames = []
    for k in range(4):
        true = [car(4.0 * k), car(60), car(90)]
        found = [car(4.0 * k, yaw=k % 2 * np.pi), car(60, yaw=np.pi), car(90)]
        frames.append(frame_of(k, truth_boxes(true, [1, 2, 3]), {"fused": source_boxes(found)}))
    errors = figures(frames)["errors"]
    assert (errors["flips"], errors["flips_moving"]) == (0.5, 0.5)
    unknown = [replace(frame, truth=truth_boxes([car(60)])) for frame in frames]
    errors = figures(unknown)["errors"]
    assert (errors["flips"], errors["flips_moving"]) == (1, None)


def test_predictions_have_figures_of_their_own() -> None:
    def sources(x: float, *, predicted: bool) -> dict[str, SourceBoxes]:
        return {"fused": moving(source_boxes([car(x)]), (0, 0), predicted=predicted)}

    places = [(0.1, False), (0.3, True), (0.1, True), (50.0, True), (200.0, True)]
    frames = [frame_of(k, truth_boxes([car(0)], [1]), sources(x, predicted=p)) for k, (x, p) in enumerate(places)]
    config = Config(evaluate=EvaluateConfig(max_range_m=100.0))
    told = figures(frames, config)["predicted"]
    assert (told["found"], told["right"], told["precision"]) == (3, 2, pytest.approx(2 / 3))
    assert told["position_bev_m"]["mean"] == pytest.approx(0.2)
    assert told["nees"] == {"count": 2, "mean": pytest.approx((9 + 1) / 2, rel=1e-5), "inside_95": 0.5}
    none = figures([frame_of(0, truth_boxes([car(0)]), {"fused": source_boxes([car(0)])})])["predicted"]
    assert (none["found"], none["right"], none["precision"], none["nees"]["mean"]) == (0, 0, None, None)
