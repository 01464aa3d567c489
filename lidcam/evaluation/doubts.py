"""Reasons why the figures of an evaluation are doubtful or empty, and remedies."""

from collections.abc import Iterator, Mapping
from typing import Any

from lidcam.run.warning import RunWarning

ALL = "all"
"""Name of the figures of all classes."""

MIN_COVERED = 0.5
"""Smallest share of the frames that truth should cover."""

MAX_LABELS = 5
"""Largest number of labels without a class that a warning lists."""


def doubts(tree: Mapping[str, Any], *, has_truth: bool, lidars_detect: bool = True) -> tuple[RunWarning, ...]:
    """Warnings about a tree of figures; none without truth. `lidars_detect`: the run was to detect with the lidars."""
    if not has_truth:
        return ()
    return (
        *_times(tree),
        *_objects(tree["truth_objects"]),
        *_places(tree, lidars_detect=lidars_detect),
        *_taken_away(tree),
    )


def _times(tree: Mapping[str, Any]) -> Iterator[RunWarning]:
    frames, covered = tree["frames"], tree["frames_with_truth"]
    if frames and covered < MIN_COVERED * frames:
        yield RunWarning(
            "truth",
            f"it covers the time of {covered or 'none'} of {frames} frames",
            "check that it is of the same recording, and that its stamps are of the same clock"
            if not covered
            else "only frames with truth count",
        )


def _objects(counts: Mapping[str, Any]) -> Iterator[RunWarning]:
    reasons = {
        "without_class": "of no configured class",
        "marked_as_ignored": "marked as ignored",
        "outside": "outside of evaluate.region or evaluate.max_range_m",
        "unseen": "without a lidar point and without a pixel",
    }
    found = [f"{counts[name]} {words}" for name, words in reasons.items() if counts[name]]
    if found and not counts["evaluated"]:
        yield RunWarning(
            "truth",
            f"none of its objects is evaluated: {', '.join(found)}",
            "look at the section evaluate of the settings",
        )
    labels = sorted(counts["labels_without_class"].items(), key=lambda item: (-item[1], item[0]))
    if labels:
        listed = ", ".join(f"{label} ({count})" for label, count in labels[:MAX_LABELS])
        more = f" and {len(labels) - MAX_LABELS} more" if len(labels) > MAX_LABELS else ""
        yield RunWarning(
            "truth",
            f"objects of no configured class are ignored: {listed}{more}",
            "add the words to classes.N.labels if they mean one of the classes",
        )


def _places(tree: Mapping[str, Any], *, lidars_detect: bool) -> Iterator[RunWarning]:
    for source, classes in tree.get("sources", {}).items():
        figures = classes[ALL]
        if source == "lidar" and not lidars_detect:
            yield RunWarning(
                source,
                "the run was made with detect3d.method=none, so that the lidars detect nothing",
                "process it again with another method to compare the lidars with the truth",
            )
        elif figures["truth"] and not figures["found"]:
            yield RunWarning(source, "nothing was found in any frame with truth", "look at the warnings of the run")
        elif figures["truth"] and not figures["right"]:
            yield RunWarning(
                source,
                f"none of {figures['found']} boxes lies where one of {figures['truth']} true objects of its class does",
                "check that truth and result are of the same recording and in the same frame of reference",
            )


def _taken_away(tree: Mapping[str, Any]) -> Iterator[RunWarning]:
    """Classes for which fusion is worse than a single sensor, beyond chance."""
    for name, gains in tree["fusion_gain"].items():
        gain = next(one for figure, one in gains.items() if figure.startswith("ap_bev"))
        if gain["takes_away"]:
            yield RunWarning(
                "fused",
                f"{name}: fusion takes away {-gain['value']:.2f} AP ({gain['low']:+.2f} to {gain['high']:+.2f}) from "
                f"{gain['over']} alone",
                "look at the calibration and the 2D boxes of the cameras, and at the settings associate and fuse",
            )
