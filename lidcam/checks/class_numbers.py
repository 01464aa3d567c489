"""Recorded boxes whose class is a number that no class has."""

import re
from collections.abc import Mapping

from lidcam.pipeline.core.settings.config import Config
from lidcam.run.warning import RunWarning

MAX_LISTED = 10
"""Maximum number of class numbers that are named."""


def class_number_warnings(
    unused_boxes: Mapping[str, int], config: Config, unused_boxes3d: Mapping[str, int] | None = None
) -> tuple[RunWarning, ...]:
    """A warning if boxes have numbers that no class has; the other numbers may then be misread, too.

    Args:
        unused_boxes: Number of recorded 2D boxes that were not used, by reason.
        config: Settings, which say what a number means.
        unused_boxes3d: The same of recorded 3D boxes.
    """
    of_images, of_space = config.detect2d.class_numbers, config.detect3d.recorded.class_numbers
    coco, autoware = "COCO does (0 person, 2 car)", "Autoware does (1 car, 7 pedestrian)"
    remedy2d = f"if their detector numbers as {coco}, --set detect2d.class_numbers=coco"
    remedy3d = (
        f"if their detector numbers as {autoware} or as {coco}, --set detect3d.recorded.class_numbers=autoware or =coco"
    )
    return (
        *(_warnings("recorded 2D boxes", unused_boxes, remedy2d, config) if of_images == "labels" else ()),
        *(_warnings("recorded 3D boxes", unused_boxes3d or {}, remedy3d, config) if of_space == "labels" else ()),
    )


def _warnings(subject: str, unused_boxes: Mapping[str, int], remedy: str, config: Config) -> tuple[RunWarning, ...]:
    numbers = {
        int(found[1]): count
        for reason, count in unused_boxes.items()
        if (found := re.fullmatch(r"class '(\d+)' is not configured", reason))
    }
    if not numbers:
        return ()
    listed = ", ".join(map(str, sorted(numbers)[:MAX_LISTED])) + (", ..." if len(numbers) > MAX_LISTED else "")
    known = ", ".join(
        f"{label} {prior.name}" for prior in config.classes for label in prior.labels if label.isdecimal()
    )
    return (
        RunWarning(
            subject,
            f"{sum(numbers.values())} have class numbers that no class has ({listed}); known are {known or 'none'}",
            f"{remedy}; else add its numbers to the labels of the classes",
        ),
    )
