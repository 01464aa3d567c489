"""Ask the judges of tracking about the cases of `track_cases`, and record what they say.

Not run by the tests: the judges bring libraries that do not go together with those of lidcam. To run it again:

    python -m venv judges && judges/bin/pip install trackeval==1.3.0 motmetrics==1.4.0
    cd tests/pipeline/evaluation/tracking
    PYTHONPATH=../../../support ../../../../judges/bin/python record_answers.py trackeval motmetrics
"""

import json
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from track_cases import CASES, TIES_OF_TRACKS, Found, TrackCase, True_

MAX_DISTANCE_M = 2.0

Answer = dict[str, Any]


def distances(truth: tuple[True_, ...], found: tuple[Found, ...]) -> Any:
    rows = [[float(np.hypot(t.x - f.x, t.y - f.y)) for f in found] for t in truth]
    return np.array(rows).reshape(len(truth), len(found))


def trackeval_data(case: TrackCase, similarity: Callable[[Any, Any], Any]) -> dict[str, Any]:
    def numbered(frames: tuple[tuple[Any, ...], ...]) -> tuple[list[Any], int]:
        number = {track: k for k, track in enumerate(sorted({row.track for rows in frames for row in rows}))}
        return [np.array([number[row.track] for row in rows], int) for rows in frames], len(number)

    truth, truth_tracks = numbered(case.truth)
    found, found_tracks = numbered(case.found)
    return {
        "num_timesteps": len(truth),
        "num_gt_dets": sum(map(len, truth)),
        "num_tracker_dets": sum(map(len, found)),
        "num_gt_ids": truth_tracks,
        "num_tracker_ids": found_tracks,
        "gt_ids": truth,
        "tracker_ids": found,
        "similarity_scores": [similarity(t, f) for t, f in zip(case.truth, case.found, strict=True)],
    }


def by_distance(truth: tuple[True_, ...], found: tuple[Found, ...]) -> Any:
    return np.maximum(0, 1 - distances(truth, found) / MAX_DISTANCE_M)


def by_half_distance(truth: tuple[True_, ...], found: tuple[Found, ...]) -> Any:
    """Above 0.5 where the distance is below the largest of a match, as Identity has its threshold."""
    return np.maximum(0, 1 - distances(truth, found) / (2 * MAX_DISTANCE_M))


def ask_trackeval(cases: dict[str, TrackCase]) -> Answer:
    """HOTA of each case; and HOTA and IDF1 of all as classes of one result."""
    metrics = import_module("trackeval.metrics")
    hota, identity = metrics.HOTA(), metrics.Identity({"PRINT_CONFIG": False, "THRESHOLD": 0.5 + 1e-12})
    names = ("HOTA", "DetA", "AssA", "LocA", "DetRe", "DetPr", "AssRe", "AssPr")
    answers = {name: hota.eval_sequence(trackeval_data(case, by_distance)) for name, case in cases.items()}
    classes = {name: answers[name] for name in cases if name not in TIES_OF_TRACKS}
    answers["all"] = hota.combine_classes_det_averaged(classes)
    said: Answer = {
        name: {"hota": {key: float(np.mean(answer[key])) for key in names}} for name, answer in answers.items()
    }
    followed = {
        name: identity.eval_sequence(trackeval_data(case, by_half_distance))
        for name, case in cases.items()
        if name not in TIES_OF_TRACKS
    }
    said["all"]["identity"] = {"IDF1": float(identity.combine_classes_det_averaged(followed)["IDF1"])}
    return said


def ask_motmetrics(cases: dict[str, TrackCase]) -> Answer:
    motmetrics = import_module("motmetrics")
    names = (
        *("mota", "motp", "num_matches", "num_switches", "num_false_positives", "num_misses", "num_fragmentations"),
        *("idf1", "idp", "idr"),
    )
    answers = {}
    for name, case in cases.items():
        accumulator = motmetrics.MOTAccumulator(auto_id=True)
        for truth, found in zip(case.truth, case.found, strict=True):
            apart = distances(truth, found)
            apart[apart >= MAX_DISTANCE_M] = np.nan
            accumulator.update([row.track for row in truth], [row.track for row in found], apart)
        summary = motmetrics.metrics.create().compute(accumulator, metrics=names)
        answers[name] = {key: number(summary[key].iloc[0]) for key in names}
    return answers


def number(value: Any) -> float | None:
    return None if isnan(value) else float(value)


JUDGES: dict[str, tuple[Callable[[dict[str, TrackCase]], Answer], tuple[str, ...]]] = {
    "trackeval": (ask_trackeval, ("trackeval", "numpy", "scipy")),
    "motmetrics": (ask_motmetrics, ("motmetrics", "numpy", "scipy")),
}

if __name__ == "__main__":
    for judge_name in sys.argv[1:]:
        ask, packages = JUDGES[judge_name]
        versions = json.dumps({name: version(name) for name in packages}, sort_keys=True)
        said = sorted(ask({k: v() for k, v in CASES.items()}).items())
        cases = ",\n".join(f"{json.dumps(name)}: {json.dumps(found, sort_keys=True)}" for name, found in said)
        text = f'{{"versions": {versions}, "cases": {{\n{cases}\n}}}}\n'
        (Path(__file__).parent / "recorded" / f"{judge_name}.json").write_text(text, encoding="utf-8")
