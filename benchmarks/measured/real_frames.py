"""How many cars, pedestrians and cyclists are found in labelled real frames: by the lidar, by the cameras, fused.

    python benchmarks/measured/real_frames.py DATA MODEL.onnx [--set detect2d.min_score=0.2 ...] [--frame 000008]
                                              [--json FILE]

DATA is a folder below which there are frames of KITTI's object benchmark; see `labelled_frames`. Every frame is a
recording of its own, processed as a user would. A labelled object counts within 40 m, and is found by a box of its
class whose centre is within 2 m on the ground; false are boxes in the image and within 40 m that are no object of
their class.
"""

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from counting import CLASSES, Count, Found, count_frame
from labelled_frames import LabelledFrame, labelled_frames, write_recording

import lidcam
from pipeline.core.detections import Boxes3D

Counts = dict[str, dict[str, dict[str, Count]]]
"""By source, label and name of the frame."""


class Watcher(lidcam.RunObserver):
    """Counts what each source found in the frame of a recording, by source and label."""

    def __init__(self, frame: LabelledFrame) -> None:
        self._frame = frame
        self._source: lidcam.RunInput | None = None
        self.counts: dict[str, dict[str, Count]] = {}

    def opened(self, source: lidcam.RunInput) -> None:
        """See `RunObserver`."""
        self._source = source

    def frame(self, result: lidcam.FrameResult) -> None:
        """See `RunObserver`."""
        found, placed = result.detections, result.detections.placed
        by_source = {"lidar": found.lidar, "cameras": placed, "fused": result.fused.objects}
        self.counts = {name: self._count(boxes) for name, boxes in by_source.items() if boxes is not None}

    def _count(self, boxes: Boxes3D) -> dict[str, Count]:
        if self._source is None:
            raise RuntimeError("a frame before the recording was opened")
        lidar = self._source.rig.lidars[0].T_site_lidar
        return count_frame(self._frame, boxes, self._source.config.class_names, lidar)


def main() -> None:
    """Process every frame, with its camera and without, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the runs")
    parser.add_argument("--config", help="a preset or a settings file; without it the one that lidcam chooses")
    parser.add_argument("--frame", action="append", default=[], metavar="NAME", help="only this frame")
    parser.add_argument("--details", action="store_true", help="every frame too, with distances of what is wrong")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", action="store_true", help="the table of docs/fusion.md")
    options = parser.parse_args()
    frames = [one for one in labelled_frames(options.data) if not options.frame or one.name in options.frame]
    if not frames:
        parser.error(f"{options.data}: expected frames of KITTI's object benchmark below it, found none")
    counts: Counts = {}
    started = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        for frame in frames:
            recording = Path(folder) / f"{frame.name}.mcap"
            write_recording(frame, recording)
            shared = {"config": options.config, "workers": 1}
            with_camera = _processed(frame, recording, shared | {"settings": options.set, "model_2d": options.model})
            alone = _processed(frame, recording, shared | {"settings": [*options.set, "detect2d.method=none"]})
            for source, by_label in (with_camera | {"without cameras": alone["fused"]}).items():
                for label, count in by_label.items():
                    counts.setdefault(source, {}).setdefault(label, {})[frame.name] = count
    if options.markdown:
        _print_markdown(counts)
        return
    for label in CLASSES:
        _print_class(label, counts, details=options.details)
    print(f"{len(frames)} frames, {time.process_time() - started:.1f} s of processor time")
    if options.json:
        options.json.write_text(json.dumps(_tree(counts), indent=1) + "\n")


def _processed(frame: LabelledFrame, recording: Path, options: dict[str, Any]) -> dict[str, dict[str, Count]]:
    watcher = Watcher(frame)
    lidcam.process_recording(lidcam.make_job(recording, **options), watcher)
    if not watcher.counts:
        raise RuntimeError(f"{frame.name}: no frame came out")
    return watcher.counts


def _print_class(label: str, counts: Counts, *, details: bool) -> None:
    print(f"\n{label:<18}{'labels':>7}{'found':>7}{'false':>7}{'position m':>12}{'yaw deg':>9}")
    for source, by_label in counts.items():
        by_frame = by_label[label]
        print(_line(source, by_frame.values()).rstrip())
        for name, one in by_frame.items() if details else ():
            missed = [f"missed at {wrong.range_m:.1f} m ({wrong.points} points)" for wrong in one.missed]
            false = [f"false at {range_m:.1f} m" for range_m in one.false]
            print(f"{_line('  ' + name, [one])}  {', '.join(missed + false)}".rstrip())


def _line(name: str, counts: Iterable[Count]) -> str:
    counts = list(counts)
    found = [one for count in counts for one in count.found]
    labels, false = sum(count.labels for count in counts), sum(len(count.false) for count in counts)
    return f"{name:<18}{labels:>7}{len(found):>7}{false:>7}{_means(found)}"


def _means(found: list[Found]) -> str:
    if not found:
        return f"{'':>12}{'':>9}"
    position_m, yaw_deg = (statistics.fmean(getattr(one, key) for one in found) for key in ("position_m", "yaw_deg"))
    return f"{position_m:>12.2f}{yaw_deg:>9.1f}"


def _print_markdown(counts: Counts) -> None:
    names = {
        "lidar": "all boxes of the lidar",
        "cameras": "cameras alone",
        "without cameras": "lidar alone, the probable ones (`detect2d.method=none`)",
        "fused": "fused",
    }
    labels = {label: sum(one.labels for one in counts["lidar"][label].values()) for label in CLASSES}
    head = [f"{label.lower()}s, {count}: found | false" for label, count in labels.items()]
    print(f"| | {' | '.join(head)} | position of cars | yaw |\n|{' --- |' * (3 + 2 * len(CLASSES))}")
    for source, name in names.items():
        by_label = [list(counts[source][label].values()) for label in CLASSES]
        told = [f"{sum(len(c.found) for c in one)} | {sum(len(c.false) for c in one)}" for one in by_label]
        position_m, yaw_deg = _means([found for count in by_label[0] for found in count.found]).split() or ["-", "-"]
        print(f"| {name} | {' | '.join(told)} | {position_m} m | {yaw_deg} deg |")


def _tree(counts: Counts) -> dict[str, Any]:
    return {
        source: {
            label: {
                "labels": sum(one.labels for one in frames.values()),
                "found": sum(len(one.found) for one in frames.values()),
                "false": sum(len(one.false) for one in frames.values()),
                "frames": {name: asdict(one) for name, one in frames.items()},
            }
            for label, frames in by_label.items()
        }
        for source, by_label in counts.items()
    }


if __name__ == "__main__":
    main()
