"""Recorded boxes whose class is a number that no class has."""

import re
from collections.abc import Mapping

from lidcam.checks.warning import RunWarning
from pipeline.core.settings.config import Config

__all__ = ["class_number_warnings"]

MAX_LISTED = 10
"""Numbers that are named."""


def class_number_warnings(unused_boxes: Mapping[str, int], config: Config) -> tuple[RunWarning, ...]:
    """A warning if boxes have numbers that no class has; the other numbers may then be misread, too.

    Args:
        unused_boxes: Number of boxes that were not used, by reason.
        config: Settings, which say what a number means.
    """
    numbers = {
        int(found[1]): count
        for reason, count in unused_boxes.items()
        if (found := re.fullmatch(r"class '(\d+)' is not configured", reason))
    }
    if not numbers or config.detect2d.class_numbers != "labels":
        return ()
    listed = ", ".join(map(str, sorted(numbers)[:MAX_LISTED])) + (", ..." if len(numbers) > MAX_LISTED else "")
    known = ", ".join(
        f"{label} {prior.name}" for prior in config.classes for label in prior.labels if label.isdecimal()
    )
    return (
        RunWarning(
            "recorded 2D boxes",
            f"{sum(numbers.values())} have class numbers that no class has ({listed}); known are {known or 'none'}",
            "if their detector numbers as COCO does (0 person, 2 car), --set detect2d.class_numbers=coco; "
            "else add its numbers to the labels of the classes",
        ),
    )
