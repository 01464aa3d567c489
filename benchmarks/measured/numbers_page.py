"""Writes docs/numbers.md: how good lidcam is on simulated recordings, class by class and source by source.

    python benchmarks/measured/numbers_page.py [--scenario NAME] [--folder out/numbers]

Recordings are simulated once and kept in the folder; another one is simulated when the simulator or the scenario
changes. They are processed with the settings that lidcam chooses itself and evaluated anew each time. With --scenario
the tables of that scenario are printed and the page stays as it is.
"""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from measured_runs import SECONDS, MeasuredRun, measured_run
from pages import ROOT, table
from side_by_side import by_class, side_by_side, verdicts
from tracks_table import measured_tracks, tracks_table

from lidcam.printing.numbers import NONE, number, percent, share, signed

PAGE = ROOT / "docs" / "numbers.md"
Tree = Mapping[str, Any]

HEAD = """# Numbers

How good lidcam is today, on simulated recordings whose truth is exact. `make numbers` writes this page anew: it
simulates, processes with the settings that lidcam chooses itself, and evaluates. [figures.md](figures.md) defines every
figure, [evaluation.md](evaluation.md) says how to get them for your own recordings. These are scenes of a simulator,
with a simulated 2D detector: they show what changes from one version to the next, not what you will get. The recordings
stay in `out/numbers/`: process one of them with `--report FILE.html` to see the worst errors as images.

- *lidar*: what the lidars alone find. *cameras*: what the cameras alone place in 3D. *fused*: the result.
- *AP bev*, *AP 3D*: average precision at an IoU of 0.5, 40 recall points. *mAP*: by distance of the centres, with
  thresholds scaled by the length of the class. *recall*, *precision*, *F1* (their harmonic mean), *false* (boxes a
  frame): of all that is reported.
- *position*, *95 %*: mean and 95th percentile of the error in metres, against where the object is at the frame's stamp;
  *when measured*: the mean against where it was when the lidars saw it, up to 0.1 s later. *heading*: median error in
  degrees, a turn by 180 degrees counted as right; *flips*: headings that are wrong by more than 90 degrees; *length*,
  *width*: mean error in metres.
- *ECE*: how far scores are from the share that is right.
- *better*, *worse*, *open*: where the interval of 95 %, from resampled blocks of frames, lies above zero, below it, or
  on both sides. A gain is positive where fusion is better, of the position too. *position* compares means, which are
  those of what each found; *found by lidar, too* compares the objects that both found, one by one.
- *Tracks*: *unfiltered* are the fused objects of each frame by itself. *nearest neighbour* numbers them, *AB3DMOT*
  (Weng et al., IROS 2020, stated anew) filters them. *online* and *offline* are lidcam's own (`track.mode`).
  *position*, *yaw* (a turn by 180 degrees counted as right) and *speed* are roots of the mean square, in metres,
  degrees and m/s; *flips, moving* are those of what moves; *in 95 %*: boxes whose error in x and y lies where their
  covariance says with 95 %; *false tracks* mostly match nothing; *switches*: objects that another track takes over;
  *fragments*: times that an object is lost and found again.
"""


def main() -> None:
    """Measure all scenarios and write the page, or print one."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenario", choices=[*SECONDS])
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "numbers")
    options = parser.parse_args()
    if options.scenario:
        print("\n".join(section(measured_run(options.scenario, options.folder))))
        return
    lines = [HEAD]
    for scenario in SECONDS:
        lines += section(measured_run(scenario, options.folder))
    PAGE.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def section(run: MeasuredRun) -> Iterator[str]:
    """The lines about one scenario."""
    figures = run.figures
    settings = (figures["settings"]["name"] or "the defaults").partition(",")[0]
    yield f"## {run.scenario}\n"
    yield (
        f"{run.seconds} s, {figures['frames']} frames, settings `{settings}`, "
        f"{figures['truth_objects']['evaluated']} true objects that a sensor saw.\n"
    )
    yield from side_by_side(figures)
    yield "Is fusion better than the better single sensor?\n"
    yield from verdicts(figures)
    yield "The rest of the figures:\n"
    yield from table(
        ["class", "source", "AP 3D", "mAP", "recall", "precision", "95 %", "when measured", "flips", "length", "width"],
        [_details(*one, run.when_measured["sources"][one[1]][one[0]]) for one in by_class(figures)],
    )
    yield "Objects found by kind, whatever class lidcam has for it:\n"
    yield from table(["object", "truth", *(f"recall, {source}" for source in figures["sources"])], _by_label(figures))
    if cameras := _cameras(figures):
        yield "2D boxes of all classes against what the images show:\n"
        yield from table(["camera", "truth", "AP 2D", "recall", "precision", "false an image"], cameras)
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
    found: dict[str, dict[str, Any]] = {}
    for name, source, one in by_class(figures):
        for label, counted in one["labels"].items() if name != "all" else ():
            found.setdefault(label, {})[source] = counted
    return [
        [label, f"{next(iter(by_source.values()))['truth']}"]
        + [share(by_source[source]["recall"]) if source in by_source else NONE for source in figures["sources"]]
        for label, by_source in sorted(found.items())
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


if __name__ == "__main__":
    main()
