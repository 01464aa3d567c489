"""How many cars, pedestrians and cyclists are found in labelled real frames: by the lidar, by the cameras, fused.

    python benchmarks/measured/real_frames.py DATA MODEL.onnx [--set detect2d.min_score=0.2 ...]

Prints a table of docs/research/networks.md. DATA is a folder below which there are frames of KITTI's object
benchmark; see `labelled_frames`. Every frame is a recording of its own, processed as a user would. A labelled object
counts within 40 m, and is found by a box of its class whose centre is within 2 m on the ground; false are boxes in the
image and within 40 m that are no object of their class.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from labelled_frames import CLASSES, Count, LabelledFrame, count_frame, labelled_frames, write_recording

import lidcam

Counts = dict[str, dict[str, list[Count]]]  # by source and label, one of each frame

SOURCES = {
    "lidar": "all boxes of the lidar",
    "cameras": "cameras alone",
    "without cameras": "lidar alone, the probable ones (`detect2d.method=none`)",
    "fused": "fused",
}


class Watcher(lidcam.RunObserver):
    """Counts what each source found in the frame of a recording, by source and label."""

    def __init__(self, frame: LabelledFrame) -> None:
        self._frame = frame
        self._source: lidcam.RunInput
        self.counts: dict[str, dict[str, Count]] = {}

    def opened(self, source: lidcam.RunInput) -> None:  # noqa: D102
        self._source = source

    def frame(self, result: lidcam.FrameResult) -> None:  # noqa: D102
        lidar, names = self._source.rig.lidars[0].T_site_lidar, self._source.config.class_names
        found, placed = result.detections, result.detections.placed
        for source, boxes in {"lidar": found.lidar, "cameras": placed, "fused": result.fused.objects}.items():
            if boxes is not None:
                self.counts[source] = count_frame(self._frame, boxes, names, lidar)


def main() -> None:
    """Process every frame, with its camera and without, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the runs")
    options = parser.parse_args()
    frames = [*labelled_frames(options.data)]
    if not frames:
        parser.error(f"{options.data}: expected frames of KITTI's object benchmark below it, found none")
    counts: Counts = {source: {label: [] for label in CLASSES} for source in SOURCES}
    with tempfile.TemporaryDirectory() as folder:
        for frame in frames:
            recording = Path(folder) / f"{frame.name}.mcap"
            write_recording(frame, recording)
            alone = _processed(frame, recording, None, [*options.set, "detect2d.method=none"])["fused"]
            by_source = _processed(frame, recording, options.model, options.set) | {"without cameras": alone}
            for source, by_label in by_source.items():
                for label, count in by_label.items():
                    counts[source][label].append(count)
    _print_table(counts)


def _processed(
    frame: LabelledFrame, recording: Path, model: Path | None, settings: list[str]
) -> dict[str, dict[str, Count]]:
    watcher = Watcher(frame)
    lidcam.process_recording(lidcam.make_job(recording, workers=1, model_2d=model, settings=settings), watcher)
    if not watcher.counts:
        raise RuntimeError(f"{frame.name}: no frame came out")
    return watcher.counts


def _print_table(counts: Counts) -> None:
    labels = {label: sum(one.labels for one in counts["lidar"][label]) for label in CLASSES}
    head = [f"{label.lower()}s, {count}: found | false" for label, count in labels.items()]
    print(f"| | {' | '.join(head)} | position of cars | yaw |\n|{' --- |' * (3 + 2 * len(CLASSES))}")
    for source, name in SOURCES.items():
        by_label = [counts[source][label] for label in CLASSES]
        cells = [f"{sum(len(one.found) for one in of)} | {sum(one.false for one in of)}" for of in by_label]
        cars = [found for one in by_label[0] for found in one.found]
        position_m, yaw_deg = np.mean(cars, 0) if cars else (np.nan, np.nan)
        errors = f"{position_m:.2f} m | {yaw_deg:.1f} deg" if cars else "-- | --"
        print(f"| {name} | {' | '.join(cells)} | {errors} |")


if __name__ == "__main__":
    main()
