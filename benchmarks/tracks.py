"""What tracks cost: online and offline beside AB3DMOT, over the same boxes of fifty cars, alternating in one run.

    python benchmarks/tracks.py [--frames 600] [--rounds 3]

Fifty cars drive in circles side by side for a minute at 10 Hz. AB3DMOT is that of `measured/trackers.py`, a loop over
tracks in numpy as its authors' is. Processor milliseconds a frame are the least of the rounds, updates are tracks times
frames.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, SourceBoxes
from lidcam.pipeline.tracking.motion import Priors
from lidcam.pipeline.tracking.offline import OfflineTracker
from lidcam.pipeline.tracking.online import OnlineTracker
from lidcam.pipeline.tracking.sightings import FrameSightings, Sightings

sys.path.insert(0, str(Path(__file__).parent / "measured"))

from trackers import SOURCE, ab3dmot

CARS, PERIOD_NS = 50, 100_000_000


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    config = Config()
    seen = [frame(index) for index in range(options.frames)]
    boxes = [as_boxes(one) for one in seen]
    trackers: dict[str, Callable[[], object]] = {
        "AB3DMOT": lambda: list(ab3dmot(boxes, config)),
        "online": lambda: run(OnlineTracker(priors(config), min_existence=0.5, max_gap_s=3.0), seen),
        "offline": lambda: run(OfflineTracker(priors(config), min_existence=0.5, window_s=60.0, max_gap_s=3.0), seen),
    }
    best = dict.fromkeys(trackers, np.inf)
    for _ in range(options.rounds):
        for name, tracker in trackers.items():
            started = time.process_time()
            tracker()
            best[name] = min(best[name], time.process_time() - started)
    print(f"{'':10}{'ms a frame':>12}{'updates/s':>12}{'x AB3DMOT':>12}")
    for name, seconds in best.items():
        updates = CARS * options.frames / seconds
        print(f"{name:10}{seconds / options.frames * 1e3:12.2f}{updates:12.0f}{seconds / best['AB3DMOT']:12.2f}")


def priors(config: Config) -> Priors:
    """The motion of the classes."""
    return Priors.of_classes(config.classes)


def run(tracker: OnlineTracker | OfflineTracker, seen: list[FrameSightings]) -> int:
    """Track all frames; how many rows that gives."""
    return sum(len(rows) for one in seen for rows in tracker.add_frame(one)) + sum(map(len, tracker.finish()))


def frame(index: int) -> FrameSightings:
    """Cars in a grid of 30 m, each in a circle of 10 m at 8 m/s, measured to 0.1 m."""
    rng = np.random.default_rng(index)
    cars = np.arange(CARS)
    angles = cars + 0.8 * index * PERIOD_NS / 1e9
    places = np.stack([cars % 10 * 30 + 10 * np.cos(angles), cars // 10 * 30 + 10 * np.sin(angles)], 1)
    yaws = (angles + np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
    sightings = Sightings(
        cars,
        np.column_stack([places + rng.normal(0, 0.1, (CARS, 2)), yaws]),
        np.full(CARS, 0.8),
        np.tile([4.0, 1.7, 1.55], (CARS, 1)),
        np.tile(np.diag([0.01, 0.01, 0.001]), (CARS, 1, 1)),
        np.zeros(CARS),
        np.full(CARS, 0.95),
        np.zeros(CARS, np.int64),
        np.ones(CARS, np.bool_),
        np.ones(CARS, np.int32),
        np.full(CARS, 99, np.int32),
        np.zeros(CARS, np.uint8),
        np.zeros((CARS, 2)),
        np.ones((CARS, 2)),
        np.full((CARS, 2, 3), np.nan),
    )
    return FrameSightings(index * PERIOD_NS, np.eye(4), sightings)


def as_boxes(seen: FrameSightings) -> EvaluationFrame:
    """The same cars as fused objects without tracks."""
    one, stamp_ns = seen.sightings, seen.stamp_ns
    boxes = replace(
        Boxes3D.empty(stamp_ns, "site"),
        centers=np.column_stack([one.boxes[:, :2], one.heights_m]),
        sizes=one.sizes,
        yaws=one.boxes[:, 2],
        scores=one.beliefs.astype(np.float32),
        class_ids=one.class_ids.astype(np.int32),
        point_counts=one.point_counts,
        covariances=one.covariances,
        sources=one.sources,
        measured_ns=np.full(CARS, stamp_ns),
    )
    source = SourceBoxes(boxes, np.full(CARS, -1))
    return EvaluationFrame(0, stamp_ns, None, {SOURCE: source}, T_fixed_site=np.eye(4))


if __name__ == "__main__":
    main()
