"""Random truth and tracks, the same on every machine: what judges of tracking were asked about.

Standard library only: the judges run it in environments of their own. `random.random` is the one source of numbers that
Python promises not to change.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import pi
from random import Random
from typing import NamedTuple

LENGTH_M, WIDTH_M = 4.0, 2.0
"""Size of all boxes. Yaws are 0 or pi, so that overlaps are those of upright rectangles."""


class True_(NamedTuple):
    track: int
    x: float
    y: float
    yaw: float


class Found(NamedTuple):
    track: int
    x: float
    y: float
    yaw: float
    score: float


@dataclass(frozen=True)
class TrackCase:
    """Truth and what was found, by frame; rows in the order of their tracks."""

    truth: tuple[tuple[True_, ...], ...]
    found: tuple[tuple[Found, ...], ...]


def separated(seed: int, frames: int = 41, objects: int = 6) -> TrackCase:
    """Objects in lanes far from each other that are missed, and change their tracks; false tracks far away."""
    random = Random(seed).random
    truth, found = [], []
    names = list(range(objects))
    for frame in range(frames):
        true = [True_(lane, frame * 0.5, lane * 20.0, 0.0) for lane in range(objects)]
        rows = []
        for row in true:
            if random() < 0.08:
                names[row.track] = objects + int(random() * 6)
            if random() < 0.2 or names.index(names[row.track]) != row.track:
                continue
            yaw = pi if random() < 0.1 else 0.0
            rows.append(
                Found(names[row.track], row.x + 2.4 * random() - 1.2, row.y + 2.4 * random() - 1.2, yaw, random())
            )
        rows += [Found(100 + k, 500.0 + k * 10, 0.0, 0.0, random()) for k in range(3) if random() < 0.2 or not k]
        truth.append(tuple(true))
        found.append(tuple(sorted(rows)))
    return TrackCase(tuple(truth), tuple(found))


def crowded(seed: int, frames: int = 40, objects: int = 7, step: float = 0.0) -> TrackCase:
    """Objects within reach of each other that come and go; tracks that stray, are doubled, swap and end.

    Args:
        seed: Of the random numbers.
        frames: Number of frames.
        objects: Number of true tracks.
        step: Grid of the positions, so that distances are equal; 0 for none.
    """
    random = Random(seed).random

    def place(value: float) -> float:
        return round(value / step) * step if step else value

    at = [[6 * random(), 6 * random()] for _ in range(objects)]
    names = [[k] if random() < 0.7 else [k, objects + k] for k in range(objects)]
    trust = [0.2 + 0.8 * random() for _ in range(4 * objects)]
    truth, found = [], []
    for frame in range(frames):
        true, rows = [], {}
        for k, (x, y) in enumerate(at):
            at[k] = [x + random() - 0.5, y + random() - 0.5]
            if (frame + 7 * k) % 19 < 4 or frame % 17 == 16:
                continue
            true.append(True_(k, place(x), place(y), 0.0))
            for name in names[k]:
                if random() < 0.75:
                    score = trust[name] if step else 0.9 * trust[name] + 0.1 * random()
                    yaw = pi if random() < 0.1 else 0.0
                    rows[name] = Found(name, place(x + 2 * random() - 1), place(y + 2 * random() - 1), yaw, score)
        if random() < 0.15:
            first, second = int(objects * random()), int(objects * random())
            names[first], names[second] = names[second], names[first]
        if random() < 0.3:
            name = 2 * objects + int(objects * random())
            rows[name] = Found(name, place(8 * random()), place(8 * random()), 0.0, trust[name])
        if frame % 13 == 12:
            rows = {}
        truth.append(tuple(true))
        found.append(tuple(rows[name] for name in sorted(rows)))
    return TrackCase(tuple(truth), tuple(found))


def twins(seed: int) -> TrackCase:
    """Pairs of objects with two tracks in the middle between them, at equal distances from both."""
    random = Random(seed).random
    truth, found = [], []
    for frame in range(30):
        true, rows = [], []
        for pair in range(4):
            x, y = 0.5 * frame, 50.0 * pair
            if random() < 0.9:
                true += [True_(2 * pair + k, x, y + k, 0.0) for k in range(2)]
            if random() < 0.8:
                rows += [Found(2 * pair + k, x + 0.25, y + 0.5, 0.0, 0.5 + 0.1 * pair) for k in range(2)]
        truth.append(tuple(true))
        found.append(tuple(rows))
    return TrackCase(tuple(truth), tuple(found))


def alone(seed: int) -> TrackCase:
    """One object, now and then found, by two tracks in turn."""
    random = Random(seed).random
    truth = tuple((True_(5, 0.3 * frame, 0.0, 0.0),) for frame in range(20))
    found = tuple(
        () if random() < 0.3 else (Found(frame // 7 % 2, row.x + 3 * random() - 1.5, 0.2, 0.0, random()),)
        for frame, (row,) in enumerate(truth)
    )
    return TrackCase(truth, found)


def equal_scores(seed: int) -> TrackCase:
    """A crowd in which many tracks have the same score."""
    case = crowded(seed)
    found = tuple(tuple(row._replace(score=0.25 + row.track % 3 / 4) for row in rows) for rows in case.found)
    return TrackCase(case.truth, found)


def perfect() -> TrackCase:
    case = separated(1)
    return TrackCase(case.truth, tuple(tuple(Found(*row, 0.5) for row in rows) for rows in case.truth))


def nothing_found() -> TrackCase:
    case = separated(2, frames=5)
    return TrackCase(case.truth, ((),) * 5)


def barely_found() -> TrackCase:
    case = separated(3, frames=20)
    return TrackCase(case.truth, (*case.found[:1], *((),) * 19))


CASES: dict[str, Callable[[], TrackCase]] = {
    **{f"separated_{seed}": partial(separated, seed) for seed in range(4)},
    **{f"crowded_{seed}": partial(crowded, seed) for seed in range(6)},
    **{f"ties_{seed}": partial(crowded, seed, step=0.5) for seed in range(4)},
    **{f"equal_scores_{seed}": partial(equal_scores, 20 + seed) for seed in range(3)},
    **{f"twins_{seed}": partial(twins, seed) for seed in range(2)},
    **{f"alone_{seed}": partial(alone, seed) for seed in range(2)},
    "perfect": perfect,
    "nothing_found": nothing_found,
    "barely_found": barely_found,
}

# Where two assignments are equally good, the judges take what their solver happens to find in the whole frame.
TIES = {name for name in CASES if name.startswith("ties")}
TIES_OF_TRACKS = {name for name in CASES if name.startswith("twins")}
