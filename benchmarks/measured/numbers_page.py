"""Writes docs/numbers.md: how good lidcam is on simulated recordings, class by class and source by source.

    python benchmarks/measured/numbers_page.py [--scenario NAME] [--folder out/numbers]

Recordings are simulated once and kept in the folder; another one is simulated when the simulator or the scenario
changes. They are processed with the settings that lidcam chooses itself and evaluated anew each time. With --scenario
the tables of that scenario are printed and the page stays as it is.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from measured_runs import ROOT, SECONDS, MeasuredRun, measured_run
from mistake_images import KINDS, Look, looks, write_images

from lidcam.printing.numbers import NONE, number, percent, share, signed

PAGE = ROOT / "docs" / "numbers.md"
Tree = Mapping[str, Any]

HEAD = """# Numbers

How good lidcam is today, on simulated recordings whose truth is exact. `make numbers` writes this page anew: it
simulates, processes with the settings that lidcam chooses itself, and evaluates. [figures.md](figures.md) defines every
figure, [evaluation.md](evaluation.md) says how to get them for your own recordings. These are scenes of a simulator,
with a simulated 2D detector: they show what changes from one version to the next, not what you will get.

- *AP bev*, *AP 3D*: average precision at an IoU of 0.5, 40 recall points. *mAP*: by distance of the centres, with
  thresholds scaled by the length of the class. *recall*, *precision*, *false* (boxes a frame): of all that is reported.
- *position*, *95 %*: mean and 95th percentile of the error in metres, against where the object is at the frame's stamp;
  *when measured*: the mean against where it was when the lidars saw it, up to 0.1 s later. *heading*: median error in
  degrees, a turn by 180 degrees counted as right; *flips*: headings that are wrong by more than 90 degrees; *length*,
  *width*: mean error in metres.
- *ECE*: how far scores are from the share that is right.
"""


def main() -> None:
    """Measure all scenarios and write the page, or print one."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenario", choices=[*SECONDS])
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "numbers")
    options = parser.parse_args()
    if options.scenario:
        print("\n".join(section(measured_run(options.scenario, options.folder), [])))
        return
    lines = [HEAD]
    for scenario in SECONDS:
        run = measured_run(scenario, options.folder)
        shown = looks(run)
        if shown:
            write_images(PAGE.with_name(f"numbers-{scenario}.jpg"), shown)
        lines += section(run, shown)
    PAGE.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def section(run: MeasuredRun, shown: Sequence[Look]) -> Iterator[str]:
    """The lines about one scenario."""
    figures = run.figures
    settings = (figures["settings"]["name"] or "the defaults").partition(",")[0]
    yield f"## {run.scenario}\n"
    yield (
        f"{run.seconds} s, {figures['frames']} frames, settings `{settings}`, "
        f"{figures['truth_objects']['evaluated']} true objects that a sensor saw.\n"
    )
    yield from table(
        ["class", "source", "truth", "AP bev", "AP 3D", "mAP", "recall", "precision", "false"],
        [
            [
                name,
                source,
                f"{one['truth']}",
                *_shares(one, "ap_bev_r40_50", "ap_3d_r40_50"),
                share(one["distance"]["map"]),
                *_shares(one, "recall", "precision", "false_per_frame"),
            ]
            for name, source, one in _by_class(figures)
        ],
    )
    yield from table(
        ["class", "source", "position", "95 %", "when measured", "heading", "flips", "length", "width", "ECE"],
        [
            _errors(name, source, one, run.when_measured["sources"][source][name])
            for name, source, one in _by_class(figures)
        ],
    )
    yield "What was found of each kind of object, whatever class lidcam has for it:\n"
    yield from table(["object", "truth", *(f"recall, {source}" for source in figures["sources"])], _by_label(figures))
    yield "What fusion adds to the lidars alone, with the interval of 95 % from resampled blocks of frames:\n"
    yield from table(["class", "AP bev", "AP 3D", "recall", "precision"], _gains(figures))
    if cameras := _cameras(figures):
        yield "2D boxes of all classes against what the images show:\n"
        yield from table(["camera", "truth", "AP 2D", "recall", "precision", "false an image"], cameras)
    if shown:
        yield from _mistakes(run, shown)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """The lines of a table, and an empty one; nothing without rows."""
    if rows:
        yield f"| {' | '.join(head)} |"
        yield f"|{' --- |' * len(head)}"
        yield from (f"| {' | '.join(row)} |" for row in rows)
        yield ""


def _errors(name: str, source: str, one: Tree, when_measured: Tree) -> list[str]:
    errors = one["errors"]
    return [
        name,
        source,
        *(number(errors["position_bev_m"][key], 2) for key in ("mean", "p95")),
        number(when_measured["errors"]["position_bev_m"]["mean"], 2),
        number(errors["heading_mod_180_deg"]["p50"], 1),
        percent(errors["flips"]),
        *(signed(errors[side]["bias"], 2) for side in ("length_m", "width_m")),
        share(one["calibration"]["ece"]),
    ]


def _by_label(figures: Tree) -> list[list[str]]:
    found: dict[str, dict[str, Any]] = {}
    for name, source, one in _by_class(figures):
        for label, counted in one["labels"].items() if name != "all" else ():
            found.setdefault(label, {})[source] = counted
    return [
        [label, f"{next(iter(by_source.values()))['truth']}"]
        + [share(by_source[source]["recall"]) if source in by_source else NONE for source in figures["sources"]]
        for label, by_source in sorted(found.items())
    ]


def _gains(figures: Tree) -> list[list[str]]:
    rows = []
    names = dict.fromkeys(name for name, _, _ in _by_class(figures))
    for name in names:
        gain = figures["fusion_gain"][name]
        if gain["recall"]["value"] is not None:
            told = [gain[key] for key in ("ap_bev_r40_50", "ap_3d_r40_50", "recall", "precision")]
            rows.append([name, *map(_gain, told)])
    return rows


def _gain(gain: Tree) -> str:
    if gain["value"] is None:
        return NONE
    interval = "" if gain["low"] is None else f" ({signed(gain['low'], 2)} to {signed(gain['high'], 2)})"
    return f"{signed(gain['value'], 2)}{interval}{' takes away' if gain['takes_away'] else ''}"


def _cameras(figures: Tree) -> list[list[str]]:
    return [
        [
            camera,
            f"{one['truth']}",
            *_shares(one, "ap_2d_r40_50", "recall", "precision"),
            number(one["false_per_image"], 2),
        ]
        for camera, classes in figures["images"].items()
        if (one := classes["all"])["truth"]
    ]


def _mistakes(run: MeasuredRun, shown: Sequence[Look]) -> Iterator[str]:
    yield (
        "The worst errors, numbered as in the image below, row by row. After `make numbers` the recording is in "
        "`out/numbers/`: process it with `--rerun FILE.rrd`, and go to the time.\n"
    )
    for kind, title in zip(KINDS, ("reported, and not there", "there, and not reported"), strict=True):
        rows = [[f"{row}", *_mistake(look)] for row, look in enumerate(shown, 1) if look.kind == kind]
        yield from table(
            [title, "class", "what it is", "frames", "at (s)", "x, y (m)", "score or points", "camera"], rows
        )
    yield f"![the worst errors of {run.scenario}](numbers-{run.scenario}.jpg)\n"


def _mistake(look: Look) -> list[str]:
    one = look.mistake
    points = NONE if one["lidar_points"] is None else f"{one['lidar_points']} points"
    weight = f"{one['score']:.2f}" if look.kind == "false" else points
    place = f"{one['x_m']:z.1f}, {one['y_m']:z.1f}"
    return [one["class"], look.name, f"{one['frames']}", f"{one['worst_s']:.1f}", place, weight, look.camera or "none"]


def _by_class(figures: Tree) -> Iterator[tuple[str, str, Tree]]:
    """Classes with truth or detections, and all of them if there are several; each with its sources."""
    sources: Tree = figures["sources"]
    met = [
        name
        for name in next(iter(sources.values()))
        if any(classes[name][count] for classes in sources.values() for count in ("truth", "found"))
    ]
    for name in met[:1] if len(met) == 2 else met:
        yield from ((name, source, classes[name]) for source, classes in sources.items())


def _shares(one: Tree, *names: str) -> list[str]:
    return [share(one[name]) for name in names]


if __name__ == "__main__":
    main()
