"""Sightings of objects whose motion is known, for tests of tracks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.tracking.motion import Priors
from lidcam.pipeline.tracking.sightings import FrameSightings, Sightings

PRIORS = Priors.of_classes(ROAD_CLASSES)
CAR, PEDESTRIAN, BICYCLE, TRUCK, BUS = range(5)
PERIOD_S = 0.1
START_NS = 1_700_000_000_000_000_000

Place = Callable[[float], tuple[float, float, float]]
"""x, y and yaw at a time in seconds."""


@dataclass(frozen=True)
class Mover:
    """An object: where it is, and in which frames it is seen as what."""

    place: Place
    class_id: int = CAR
    size: tuple[float, float, float] = (4.0, 1.7, 1.5)
    belief: float = 0.95
    seen: Callable[[int], bool] = lambda _: True
    classes: Sequence[int] = ()
    turned: Callable[[int], bool] = lambda _: False


def straight(x: float, y: float, yaw: float, speed: float) -> Place:
    return lambda t: (x + speed * t * np.cos(yaw), y + speed * t * np.sin(yaw), yaw)


def circling(radius: float, speed: float, rear_m: float) -> Place:
    """The centre of a vehicle whose rear axle drives round the origin."""

    def place(t: float) -> tuple[float, float, float]:
        angle = speed / radius * t
        yaw = angle + np.pi / 2
        return radius * np.cos(angle) + rear_m * np.cos(yaw), radius * np.sin(angle) + rear_m * np.sin(yaw), yaw

    return place


def frame(
    rows: Sequence[tuple[F64, Mover, int]], index: int, later_s: float = 0.0, noise_m: float = 0.05
) -> FrameSightings:
    """One frame of boxes (x, y, yaw) of movers with their classes."""
    n = len(rows)
    boxes = np.array([row[0] for row in rows]).reshape(n, 3)
    beliefs = np.array([row[1].belief for row in rows])
    sizes = np.array([row[1].size for row in rows]).reshape(n, 3)
    covariances = np.tile(np.diag([noise_m**2, noise_m**2, (0.6 * noise_m) ** 2]), (n, 1, 1))
    sightings = Sightings(
        np.arange(n),
        boxes,
        np.full(n, 0.75),
        sizes,
        covariances,
        np.full(n, later_s),
        beliefs,
        np.array([row[2] for row in rows], np.int64).reshape(n),
        beliefs >= 0.5,
        np.ones(n, np.int32),
        np.full(n, 50, np.int32),
        np.full(n, 2, np.uint8),
        np.zeros((n, 2)),
        np.ones((n, 2)),
        np.ones(n, np.bool_),
    )
    return FrameSightings(START_NS + round(index * PERIOD_S * 1e9), np.eye(4), sightings)


def scene(movers: Sequence[Mover], count: int, *, noise_m: float = 0.05, later_s: float = 0.0) -> list[FrameSightings]:
    """Frames of movers, each seen with some noise, `later_s` after the stamp."""
    rng = np.random.default_rng(1)
    frames = []
    for index in range(count):
        rows = []
        for mover in movers:
            noise = rng.normal(size=3) * [noise_m, noise_m, 0.4 * noise_m]
            if not mover.seen(index):
                continue
            box = np.array(mover.place(index * PERIOD_S + later_s)) + noise
            box[2] = (box[2] + np.pi * mover.turned(index) + np.pi) % (2 * np.pi) - np.pi
            rows.append((box, mover, mover.classes[index % len(mover.classes)] if mover.classes else mover.class_id))
        frames.append(frame(rows, index, later_s, max(noise_m, 0.05)))
    return frames
