"""The objects of frames in a Rerun recording: boxes, labels, trails, and the zones with their counts."""

from collections.abc import Iterable

import rerun as rr

from lidcam.pipeline.core.arrays import Bools
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.writers.drawing import DrawnObjects
from lidcam.writers.labels_3d import LabelPlaces
from lidcam.writers.palette import ZONE
from lidcam.writers.rerun import archetypes
from lidcam.writers.rerun.blueprint import FOV_Y_DEG, LABELS, NUMBERS, PLACED, place_eye
from lidcam.writers.trails import Trails
from lidcam.writers.viewpoint import SceneSurvey, drawn_zones, zone_texts


class News:
    """Remembers at which paths nothing is drawn; at `empty` ones, nothing is at first."""

    def __init__(self, empty: Iterable[str] = ()) -> None:
        self._empty = set(empty)

    def at(self, path: str, count: int) -> bool:
        """Whether so many things at a path are to be logged: not where there are none, and there were none."""
        if count == 0 and path in self._empty:
            return False
        (self._empty.discard if count else self._empty.add)(path)
        return True

    def cleared(self, path: str) -> None:
        """Take note that nothing is drawn at a path any more."""
        self._empty.add(path)


_OF_TRACKS = ("world/predicted", "world/predicted/uncertainty", "world/trails")


class ObjectLog:
    """Logs the objects of one run's frames.

    Args:
        survey: Of the frames: places labels and zones.
    """

    def __init__(self, recording: rr.RecordingStream, rig: Rig, config: Config, survey: SceneSurvey) -> None:
        self._recording, self._rig, self._config, self._survey = recording, rig, config, survey
        self._label_places = LabelPlaces(survey, place_eye, FOV_Y_DEG)
        self._trails = Trails(rig.site_frame, config.combine.motion)
        self._news = News(_OF_TRACKS)
        self._has_placed = False

    def log_zones(self) -> None:
        """Log the outlines of the zones, once enough of the scene was seen."""
        if self._rig.zones:
            outlines, middles = drawn_zones(self._survey)
            lines = rr.LineStrips3D(outlines, colors=ZONE.bytes_rgb, radii=rr.Radius.ui_points(1.0))
            self._recording.log("world/zones", lines, static=True)
            texts = rr.Points3D(middles, colors=ZONE.bytes_rgb, radii=0.0, show_labels=True)
            self._recording.log("world/zones/counts", texts, static=True)  # each frame has its own labels

    def log(self, drawn: DrawnObjects) -> None:
        """Log the objects of a frame at the time that is set."""
        result, log, strong = drawn.result, self._recording.log, drawn.strong
        seen, thin = strong & ~drawn.thin, strong & drawn.thin
        placed, predicted = thin & ~drawn.predicted, thin & drawn.predicted
        looks: tuple[tuple[str, Bools, archetypes.Look], ...] = (
            ("world/objects", seen, "strong"),
            ("world/placed", placed, "thin"),
            ("world/predicted", predicted, "thin"),
            ("world/faint", ~strong, "faint"),
        )
        for path, rows, look in looks:
            if self._news.at(path, int(rows.sum())):
                shown = archetypes.objects_3d(drawn, rows, look)
                log(path, shown, archetypes.object_facts(drawn, rows))
        if self._news.at("world/objects/heading", int(seen.sum())):
            log("world/objects/heading", archetypes.heading_arrows(drawn, seen))
            log("world/objects/faces", archetypes.faces_3d(drawn, seen))
        if self._news.at(LABELS, int(strong.sum())):
            self._log_texts(drawn)
        if self._rig.zones:
            texts = zone_texts(self._rig, drawn.boxes.centers)
            log("world/zones/counts", rr.Points3D.from_fields(labels=texts))
        for path, rows in (("world/placed", placed), ("world/predicted", predicted)):
            if self._news.at(f"{path}/uncertainty", int(rows.sum())):
                log(f"{path}/uncertainty", archetypes.object_ellipses(drawn, rows))
        paths = self._trails.add_frame(result)
        if self._news.at("world/trails", sum(len(path) > 0 for path in paths)):
            log("world/trails", archetypes.trails(drawn, paths))
        if (found := result.detections.placed) is not None:
            if self._news.at(PLACED, len(found)):
                log(PLACED, archetypes.placed_boxes(found, self._config.object_names))
                log(f"{PLACED}/uncertainty", archetypes.placed_ellipses(found))
            self._has_placed = True
        elif self._has_placed:
            log(PLACED, rr.Clear(recursive=True))
            self._has_placed = False
            self._news.cleared(PLACED)

    def _log_texts(self, drawn: DrawnObjects) -> None:
        """The labels of objects, apart as the first view's eye sees them, and their numbers for the view from above."""
        places, strong = self._label_places.of(drawn), drawn.strong
        self._recording.log(LABELS, archetypes.object_texts(drawn, drawn.labels, places, strong))
        self._recording.log(f"{LABELS}/lines", archetypes.label_lines(drawn, places, strong))
        numbers = [f"#{number}" for number in drawn.tracks.tolist()]
        has_track = strong & (drawn.tracks != NO_TRACK)
        self._recording.log(NUMBERS, archetypes.object_texts(drawn, numbers, drawn.roofs, has_track))
