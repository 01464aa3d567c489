"""The tracks of a run in Rerun, each at a path of its own."""

import numpy as np
import rerun as rr

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.detections import source_names
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.writers.drawing import DrawnObjects
from lidcam.writers.palette import class_color
from lidcam.writers.rerun.archetypes import LINE_POINTS, Look, bytes_of, turns_of
from lidcam.writers.rerun.blueprint import TRACKS

KM_H = 3.6
"""Speed of one metre per second, km/h."""


class TrackLog:
    """Logs the box of each tracked object with facts to be read, and its speed to be plotted.

    Attributes:
        classes: Class of each track, by number, as it was last.
        fastest_m_s: Highest speed of a track.
    """

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._shown: dict[int, tuple[Look, bytes]] = {}  # look and colour of those in the frame before
        self.classes: dict[int, int] = {}
        self.fastest_m_s = 0.0

    def log(self, drawn: DrawnObjects, looks: list[Look]) -> None:
        """Log the tracks of a frame, of whose objects (N,) the looks are given; those that are gone are cleared."""
        tracks = drawn.result.fused.tracks or Tracks.none(len(drawn.boxes))
        boxes, colors, turns, speeds = drawn.boxes, bytes_of(drawn.colors), turns_of(drawn.boxes.yaws), tracks.speeds
        sources = source_names(boxes.sources)
        gone, self._shown, before = set(self._shown), {}, self._shown
        for row in np.flatnonzero(drawn.tracks != NO_TRACK).tolist():
            number, class_id, speed = int(drawn.tracks[row]), int(boxes.class_ids[row]), float(speeds[row])
            path = f"{TRACKS}/{number}"
            gone.discard(number)
            if number not in self.classes:
                self._name(path, class_id, f"{drawn.class_names[class_id]} #{number}")
            self.classes[number], self.fastest_m_s = class_id, max(self.fastest_m_s, speed)
            look = self._shown[number] = looks[row], colors[row].tobytes()
            if before.get(number) != look:
                self._recording.log(path, _style(looks[row], colors[row]))
            box = rr.Boxes3D.from_fields(
                centers=boxes.centers[row], half_sizes=boxes.sizes[row] / 2, quaternions=turns[row]
            )
            is_known = np.isfinite(speed)
            facts = {  # texts, as numbers would be curves in the plots
                "object": drawn.labels[row],
                "speed": f"{speed:.1f} m/s, {KM_H * speed:.0f} km/h" if is_known else "unknown",
                "source": sources[row],
                "existence": f"{tracks.existence[row]:.2f}",
                "age": f"{tracks.ages_s[row]:.1f} s",
            }
            texts = rr.DynamicArchetype(
                "lidcam.Track", components={name: rr.components.TextBatch([text]) for name, text in facts.items()}
            )
            self._recording.log(path, box, texts, rr.Scalars(speed))
        for number in sorted(gone):
            self._recording.log(f"{TRACKS}/{number}", rr.Clear(recursive=False))

    def _name(self, path: str, class_id: int, name: str) -> None:
        lines = rr.SeriesLines(colors=class_color(class_id).bytes_rgb, names=name)
        self._recording.log(path, lines, static=True)


def _style(look: Look, color: U8) -> rr.Boxes3D:
    """What of a box stays the same from frame to frame."""
    return rr.Boxes3D.from_fields(
        colors=color,
        radii=rr.Radius.ui_points(LINE_POINTS[look]),
        fill_mode="TransparentFillMajorWireframe" if look == "strong" else "MajorWireframe",
    )
