"""Writes docs/numbers.md and docs/research/numbers.md: how good lidcam is on simulated recordings, by class and source.

    python benchmarks/measured/numbers_page.py [--scenario NAME] [--folder out/numbers]

Recordings are simulated once and kept in the folder; another one is simulated when the simulator or the scenario
changes. They are processed with the settings that lidcam chooses itself and evaluated anew each time. With --scenario
the tables of that scenario are printed and the page stays as it is.
"""

import argparse
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pages import ROOT, run_lidcam, table
from tracks_table import measured_tracks, tracks_table

from lidcam.cli.printing.numbers import NONE, number, percent, share, signed
from lidcam.pipeline.evaluation.evaluation_frame import figure_at
from lidcam.readers.results.result import open_result

PAGE, DETAILS_PAGE = ROOT / "docs" / "numbers.md", ROOT / "docs" / "research" / "numbers.md"
Tree = Mapping[str, Any]

HEAD = """# Numbers

Accuracy of lidcam on simulated recordings with exact ground truth. Calibration, camera clocks and 2D boxes have
[small errors](simulator.md#errors), as in real recordings. `make numbers` generates this page: it simulates, processes
with the default choice of settings, and evaluates. A simulator and a simulated 2D detector show changes between
versions, not the accuracy on your recordings; [evaluation](evaluation.md) measures that. [Figures](figures.md)
defines every figure, and [more measurements](research/numbers.md) include tracks. The recordings are kept in
`out/numbers/`; process one with `--report FILE.html` to see the worst errors as images.

- *lidar*: lidars alone. *cameras*: objects placed in 3D by cameras alone. *fused*: the result.
- *AP bev .5*, *AP bev .7*, *AP 3D .7*: average precision in bird's-eye view and 3D at an IoU of 0.5 or 0.7, 40 recall
  points. *F1*: harmonic mean of recall and precision. *false*: false boxes per frame. Both match by distance: 2 m for a
  car.
- *position*: mean error in metres, against the position at the frame's stamp. *heading*: median error in degrees,
  modulo 180 degrees. *ECE*: expected calibration error of the scores.
- *better*, *worse*, *open*: the 95 % interval, from resampled blocks of frames, is above zero, below zero, or includes
  zero. Positive gains mean that fusion is better, also for the position. *position* compares the mean errors of all
  objects of each source; *found by lidar, too* compares the objects that both found, one by one.
"""

DETAILS_HEAD = """# Numbers: measurements

Further figures for the recordings of [numbers](../numbers.md).

- *AP 3D*: at an IoU of 0.5. *mAP*: by distance of the centres, with thresholds scaled by the length of the class.
- *95 %*: 95th percentile of the position error in metres. *when measured*: mean error against the position when the
  lidars saw the object, up to 0.1 s later. *flips*: headings off by more than 90 degrees. *length*, *width*: mean error
  in metres.
- *Tracks*: *unfiltered* are the fused objects of each frame by itself. *AB3DMOT* (Weng et al., IROS 2020,
  reimplemented) filters them. *online* and *offline* are lidcam's own tracks (`track.mode`).
  *position*, *yaw* (modulo 180 degrees) and *speed* are root mean square errors in metres, degrees and m/s. *flips,
  moving*: flips of moving objects. *in 95 %*: boxes whose x, y error is within the 95 % ellipse of their covariance.
  *false tracks*: tracks that mostly match no object. *switches*: objects taken over by another track. *fragments*:
  times that an object is lost and found again.
"""


FOUND: Mapping[str, Callable[[Tree], str]] = {
    "F1": lambda one: share(one["f1"]),
    "false": lambda one: share(one["false_per_frame"]),
}
OVERLAPPING: Mapping[str, Callable[[Tree], str]] = {
    "AP bev .5": lambda one: share(one["ap_bev_r40_50"]),
    "AP bev .7": lambda one: share(one["ap_bev_r40_70"]),
    "AP 3D .7": lambda one: share(one["ap_3d_r40_70"]),
}
PLACED: Mapping[str, Callable[[Tree], str]] = {
    "position": lambda one: number(one["errors"]["position_bev_m"]["mean"], 2),
    "heading": lambda one: number(one["errors"]["heading_mod_180_deg"]["p50"], 1),
    "ECE": lambda one: share(one["calibration"]["ece"]),
}
"""Columns of the three tables, and how each figure stands there."""

GAINS = {"AP bev .5": "ap_bev_r40_50", "F1": "f1", "position": "errors.position_bev_m.mean"}
"""Figures in which fusion should be better, by their names in the JSON."""

SECONDS = {"sandbox": 20, "crossing": 10, "vehicle": 10}  # by scenario
RECORDED = ("--set", "cameras.*.jpeg_quality=40", "--errors")
WRITTEN = ("--set", "output.images=false", "--set", "output.clouds=false")  # boxes alone are evaluated

MODES = ("none", "online", "offline")
"""Modes of tracks: frames by themselves, frame by frame, and with the future of each frame."""


@dataclass(frozen=True)
class MeasuredRun:
    """A simulated recording and its result."""

    scenario: str
    figures: dict[str, Any]  # the JSON of `lidcam evaluate`, with the settings that lidcam chooses itself
    when_measured: dict[str, Any]  # the same against where objects were at the time of their lidar points
    by_mode: dict[str, Path]  # results with each of `MODES` of tracks


def main() -> None:
    """Measure all scenarios and write the page, or print one."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenario", choices=[*SECONDS])
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "numbers")
    options = parser.parse_args()
    if options.scenario:
        run = measured_run(options.scenario, options.folder)
        print("\n".join([*section(run), *details(run)]))
        return
    runs = [measured_run(scenario, options.folder) for scenario in SECONDS]
    for page, head, lines_of in ((PAGE, HEAD, section), (DETAILS_PAGE, DETAILS_HEAD, details)):
        lines = [head, *(line for run in runs for line in lines_of(run))]
        page.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def section(run: MeasuredRun) -> Iterator[str]:
    """The lines about one scenario: each sensor beside the fusion, and the gain."""
    figures = run.figures
    settings = (figures["settings"]["name"] or "the defaults").partition(",")[0]
    yield f"## {run.scenario}\n"
    yield (
        f"{SECONDS[run.scenario]} s, {figures['frames']} frames, settings `{settings}`, "
        f"{figures['truth_objects']['evaluated']} true objects seen by a sensor.\n"
    )
    yield from side_by_side(figures)
    yield "Gain of fusion over the better single sensor:\n"
    yield from verdicts(figures)


def details(run: MeasuredRun) -> Iterator[str]:
    """The other figures of one scenario."""
    figures = run.figures
    yield f"## {run.scenario}\n"
    yield from table(
        ["class", "source", "AP 3D", "mAP", "recall", "precision", "95 %", "when measured", "flips", "length", "width"],
        [_details(*one, run.when_measured["sources"][one[1]][one[0]]) for one in by_class(figures)],
    )
    yield "Recall by label, regardless of the reported class:\n"
    yield from table(["object", "truth", *(f"recall, {source}" for source in figures["sources"])], _by_label(figures))
    if cameras := _cameras(figures):
        yield "2D boxes of all classes against the objects in the images:\n"
        yield from table(["camera", "truth", "AP 2D", "recall", "precision", "false per image"], cameras)
    yield "Tracks:\n"
    own = {mode: path for mode, path in run.by_mode.items() if mode != "none"}
    yield from tracks_table(measured_tracks(run.by_mode["none"], own), [*own])


def _details(name: str, source: str, one: Tree, when_measured: Tree) -> list[str]:
    errors = one["errors"]
    shares = [share(one["ap_3d_r40_50"]), share(one["distance"]["map"]), *_shares(one, "recall", "precision")]
    later_m = when_measured["errors"]["position_bev_m"]["mean"]
    position = [number(errors["position_bev_m"]["p95"], 2), number(later_m, 2), percent(errors["flips"])]
    return [name, source, *shares, *position, *(signed(errors[side]["bias"], 2) for side in ("length_m", "width_m"))]


def _by_label(figures: Tree) -> list[list[str]]:
    by_source = [classes["all"]["labels"] for classes in figures["sources"].values()]
    return [
        [label, f"{one['truth']}", *(share(labels[label]["recall"]) for labels in by_source)]
        for label, one in by_source[0].items()
    ]


def _cameras(figures: Tree) -> list[list[str]]:
    rows = []
    for camera, classes in figures["images"].items():
        if (one := classes["all"])["truth"]:
            shares = _shares(one, "ap_2d_r40_50", "recall", "precision")
            rows.append([camera, f"{one['truth']}", *shares, number(one["false_per_image"], 2)])
    return rows


def _shares(one: Tree, *names: str) -> list[str]:
    return [share(one[name]) for name in names]


def side_by_side(figures: Tree) -> Iterator[str]:
    """Figures of detection, overlap and placement: a row for each class, the sources beside one another."""
    sources: Tree = figures["sources"]
    for columns in (FOUND, OVERLAPPING, PLACED):
        head = [f"{column}, {source}" for column in columns for source in sources]
        rows = [
            [name, f"{next(iter(sources.values()))[name]['truth']}"]
            + [shown(sources[source][name]) for shown in columns.values() for source in sources]
            for name in classes_met(figures)
        ]
        yield from table(["class", "truth", *head], rows)


def verdicts(figures: Tree) -> Iterator[str]:
    """Whether fusion is better than the better single sensor, by class and figure, with the interval of 95 %."""
    names = [name for name in classes_met(figures) if figures["fusion_gain"][name]["recall"]["value"] is not None]
    singles = [source for source in figures["sources"] if source != "fused"]
    rows = [
        [name]
        + [_verdict(figure_at(figures["fusion_gain"][name], key)) for key in GAINS.values()]
        + [_verdict(figures["fusion_gain"][name]["same_objects"][single]) for single in singles]
        for name in names
    ]
    yield from table(["class", *GAINS, *(f"position, found by {single}, too" for single in singles)], rows)


def _verdict(gain: Tree) -> str:
    if gain["value"] is None:
        return NONE
    value = signed(gain["value"], 2) + (f" over {gain['over']}" if "over" in gain else "")
    if gain["low"] is None:
        return value
    certain = "better" if gain["low"] > 0 else "worse" if gain["high"] < 0 else "open"
    return f"{certain}: {value} ({signed(gain['low'], 2)} to {signed(gain['high'], 2)})"


def classes_met(figures: Tree) -> list[str]:
    """Classes with truth or detections, and all of them together if there are several."""
    sources: Tree = figures["sources"]
    met = [
        name
        for name in next(iter(sources.values()))
        if any(classes[name][count] for classes in sources.values() for count in ("truth", "found"))
    ]
    return met[:1] if len(met) == 2 else met


def by_class(figures: Tree) -> Iterator[tuple[str, str, Tree]]:
    """Class, source and figures: the classes that were met, each with all sources."""
    for name in classes_met(figures):
        yield from ((name, source, classes[name]) for source, classes in figures["sources"].items())


def measured_run(scenario: str, folder: Path) -> MeasuredRun:
    """Simulate a scenario unless the folder holds its recording, process it, evaluate the result."""
    folder.mkdir(parents=True, exist_ok=True)
    recording = folder / f"{scenario}-{_origin(scenario)}.mcap"
    if not recording.exists():
        for old in folder.glob(f"{scenario}-*.mcap"):
            old.unlink()
        run_lidcam("simulate", scenario, recording, "--duration", SECONDS[scenario], *RECORDED)
    result = folder / f"{scenario}.mcap"
    files = {name: folder / f"{scenario}.{name}.json" for name in ("figures", "when_measured")}
    run_lidcam("process", recording, result, "--overwrite", *WRITTEN)
    run_lidcam("evaluate", result, "--json-file", files["figures"])
    run_lidcam("evaluate", result, "--json-file", files["when_measured"], "--set", "evaluate.truth_time=points")
    trees = {name: json.loads(path.read_bytes()) for name, path in files.items()}
    return MeasuredRun(scenario, **trees, by_mode=_by_mode(recording, result))


def _by_mode(recording: Path, result: Path) -> dict[str, Path]:
    """Results by their mode of tracks; that of `result` is its own."""
    with open_result(result) as opened:
        own = opened.config.track.mode
    found = {mode: result if mode == own else result.with_suffix(f".{mode}.mcap") for mode in MODES}
    for mode, path in found.items():
        if mode != own:
            run_lidcam("process", recording, path, "--overwrite", *WRITTEN, "--set", f"track.mode={mode}")
    return found


def _origin(scenario: str) -> str:
    """A checksum of all that a simulated recording is made from: another one is simulated when it changes."""
    digest = hashlib.sha256(repr((scenario, SECONDS[scenario], RECORDED)).encode())
    sources = sorted((ROOT / "bags" / "simulator").rglob("*.py"))
    for path in [*sources, ROOT / "config" / "scenarios" / f"{scenario}.yaml"]:
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


if __name__ == "__main__":
    main()
