"""Tracks side by side: frames by themselves, two trackers of others, and lidcam's own tracks, on one recording."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from pages import table
from trackers import SOURCE, ab3dmot, nearest_neighbour

from lidcam.evaluation.evaluators import measure
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, SourceBoxes
from lidcam.pipeline.evaluation.tracking.tracking_evaluation import TrackingEvaluation
from lidcam.printing.numbers import NONE, number, percent, share
from lidcam.readers.results.result import open_result
from lidcam.readers.truth.open import open_truth

Tree = Mapping[str, Any]

CLASSES = ("all", "car")
"""Classes that have rows; where cars are the only class, they are all."""

UNFILTERED = "unfiltered"
"""The objects of each frame by itself."""

FOUND: Mapping[str, Callable[[Tree], str]] = {
    "recall": lambda one: share(one["recall"]),
    "precision": lambda one: share(one["precision"]),
    "false": lambda one: share(one["false_per_frame"]),
    "position": lambda one: number(one["errors"]["position_bev_m"]["rmse"], 3),
    "yaw": lambda one: number(one["errors"]["heading_mod_180_deg"]["rmse"], 1),
    "flips": lambda one: percent(one["errors"]["flips"]),
    "flips, moving": lambda one: percent(one["errors"]["flips_moving"]),
    "speed": lambda one: number(one["errors"]["velocity_m_s"]["rmse"], 2),
    "in 95 %": lambda one: percent(one["errors"]["nees"]["inside_95"]),
}
FOLLOWED: Mapping[str, Callable[[Tree], str]] = {
    "false tracks": lambda one: str(one["false_tracks"]),
    "HOTA": lambda one: share(one["hota"]),
    "MOTA": lambda one: share(one["mota"]),
    "IDF1": lambda one: share(one["idf1"]),
    "switches": lambda one: str(one["id_switches"]),
    "fragments": lambda one: str(one["fragmentations"]),
}
"""Columns of figures that need no tracks, and of those that do."""


def measured_tracks(unfiltered: Path, tracked: Mapping[str, Path]) -> Tree:
    """The figures of tracks by different ways: `sources` and `tracking`.

    Args:
        unfiltered: A result without tracks; its truth counts.
        tracked: Results of the same recording with tracks, by the name of the way.
    """
    with ExitStack() as stack:
        result = stack.enter_context(open_result(unfiltered, ["evaluate.bootstrap=100"]))
        truth = stack.enter_context(open_truth(result))
        frames = [replace(frame, images={}) for frame in EvaluationFrames(result, truth)]
        config = result.config
        found = {name: _fused(path) for name, path in tracked.items()}
    ways = zip(frames, nearest_neighbour(frames, config), ab3dmot(frames, config), strict=True)
    compared = (_beside(frame, nearest, filtered, found) for frame, nearest, filtered in ways)
    return measure(compared, (DetectionEvaluation(config, ()), TrackingEvaluation(config)))


def _fused(path: Path) -> dict[int, SourceBoxes]:
    """The fused objects of a result by stamp."""
    with open_result(path) as result:
        return {frame.stamp_ns: frame.sources[SOURCE] for frame in result.frames() if SOURCE in frame.sources}


def _beside(
    frame: EvaluationFrame, nearest: SourceBoxes, filtered: SourceBoxes, found: Mapping[str, Mapping[int, SourceBoxes]]
) -> EvaluationFrame:
    own = {name: by_stamp[frame.stamp_ns] for name, by_stamp in found.items() if frame.stamp_ns in by_stamp}
    others = {UNFILTERED: frame.sources[SOURCE], "nearest neighbour": nearest, "AB3DMOT": filtered}
    return replace(frame, sources={**others, **own})


def tracks_table(tree: Tree, ways: Sequence[str]) -> Iterator[str]:
    """The lines of the table: all classes and cars, each with its ways; those of lidcam's own are named."""
    names = (UNFILTERED, "nearest neighbour", "AB3DMOT", *ways)
    sources, tracking = tree["sources"], tree["tracking"]
    with_truth = [name for name, one in sources[UNFILTERED].items() if name != "all" and one["truth"]]
    shown = CLASSES[1:] if with_truth == ["car"] else CLASSES
    rows = []
    for class_name in shown:
        for name in names:
            followed = tracking.get(name, {}).get(class_name)
            rows.append(
                [class_name, name]
                + [cell(sources[name][class_name]) for cell in FOUND.values()]
                + [NONE if followed is None else cell(followed) for cell in FOLLOWED.values()]
            )
    yield from table(["class", "tracks", *FOUND, *FOLLOWED], rows)
