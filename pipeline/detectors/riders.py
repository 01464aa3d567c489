"""A rider and what is ridden, which networks trained on COCO find as two objects, as one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import Bools
from lidcam.pipeline.core.detections import Boxes2D

PERSON = "person"
RIDDEN = frozenset({"bicycle", "motorcycle", "bike", "motorbike"})
RIDERS = frozenset({"cyclist", "rider", "bicyclist", "motorcyclist"})

MIN_SHARED_WIDTH = 0.6
"""Minimum shared width of a rider and what is ridden, as a share of the narrower of the two."""

FEET = (0.3, 1.05)
"""Limits of the bottom of a rider's box, in heights of the ridden one from its top: on the pedals, or on the ground."""

MIN_ABOVE = 0.2
"""Minimum height of a rider's box above that of what is ridden, in heights of the latter."""

HEIGHTS = (0.6, 2.5)
"""Limits of a rider's height, as a share of that of what is ridden: else one stands behind the other."""


def finds_riders_apart(labels: Sequence[str]) -> bool:
    """Whether a network that knows these names, in small letters, finds a rider as a person on something."""
    return PERSON in labels and not RIDDEN.isdisjoint(labels) and RIDERS.isdisjoint(labels)


def join_riders(boxes: Boxes2D, is_person: Bools, is_ridden: Bools) -> Boxes2D:
    """Join each person on a bicycle or a motorcycle with it, to one box around both.

    It has the class of what is ridden, and the better score of the two. A person rides one thing at most, and is the
    only one to ride it: of several pairs the one that lies most upright is taken first, of equal ones the first.

    Args:
        boxes: Boxes of an image, in order of falling score.
        is_person: (N,) which of them are persons.
        is_ridden: (N,) which of them are bicycles or motorcycles.

    Returns:
        Boxes in order of falling score, equal ones in the order of what is ridden.
    """
    people, ridden = np.flatnonzero(is_person), np.flatnonzero(is_ridden)
    if not (len(people) and len(ridden)):
        return boxes
    person, under = boxes.xyxy[people, None].astype(np.float64), boxes.xyxy[None, ridden].astype(np.float64)
    person_width, person_height = person[..., 2] - person[..., 0], person[..., 3] - person[..., 1]
    width, height = under[..., 2] - under[..., 0], under[..., 3] - under[..., 1]
    shared = np.minimum(person[..., 2], under[..., 2]) - np.maximum(person[..., 0], under[..., 0])
    feet = (person[..., 3] - under[..., 1]) / height
    rides = shared >= MIN_SHARED_WIDTH * np.minimum(person_width, width)
    rides &= (feet >= FEET[0]) & (feet <= FEET[1])
    rides &= under[..., 1] - person[..., 1] >= MIN_ABOVE * height
    rides &= (person_height >= HEIGHTS[0] * height) & (person_height <= HEIGHTS[1] * height)
    aside = np.abs(person[..., 0] + person[..., 2] - under[..., 0] - under[..., 2]) / np.maximum(person_width, width)
    xyxy, scores, kept = boxes.xyxy.copy(), boxes.scores.copy(), np.ones(len(boxes), np.bool_)
    taken: set[int] = set()
    pairs = np.argwhere(rides)
    for row, column in pairs[np.argsort(aside[rides], kind="stable")]:
        rider, mount = int(people[row]), int(ridden[column])
        if rider in taken or mount in taken:
            continue
        taken |= {rider, mount}
        kept[rider] = False
        xyxy[mount, :2] = np.minimum(xyxy[mount, :2], xyxy[rider, :2])
        xyxy[mount, 2:] = np.maximum(xyxy[mount, 2:], xyxy[rider, 2:])
        scores[mount] = max(scores[mount], scores[rider])
    joined = replace(boxes, xyxy=xyxy, scores=scores).select(kept)
    return joined.select(np.argsort(-joined.scores, kind="stable"))
