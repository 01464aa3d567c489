"""Reading of recordings to learn from: the points of a run, with the truth of an evaluation or the run's own tracks."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Unpack, cast

import numpy as np

from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.pillars.detector import PillarPoints
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, ResultFrame, TruthBoxes3D
from lidcam.pipeline.evaluation.ignoring import is_evaluated
from lidcam.pipeline.parallel.transfer import load
from lidcam.processing import RunObserver, process_recording
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.truth.open import open_truth
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.job import make_job
from lidcam.run.options import JobOptions
from lidcam.training.labelled import (
    MIN_PASTED_POINTS,
    NAMES,
    LabelledFrame,
    Objects,
    Recordings,
    TrueBoxes,
    loaded,
    points_in_boxes,
    saved,
)

BARE = "output.images=false", "output.clouds=false"
LIDARS_ONLY = "detect2d.method=none", "track.mode=none", *BARE  # All that is needed for the points
TRACKS = "track.mode=offline", *BARE  # A run makes its own labels

# A track's box is a label from this probability on, if the track was seen in as many frames. Other objects that are
# reported are neither objects nor background.
MIN_SURE_SCORE, MIN_SURE_FRAMES = 0.9, 5

MIN_LABELS = 20  # Boxes of sure tracks to learn from
MAX_FRAMES = 1000  # Of 1 to 2 MB each; of a longer recording, every second one is kept, then every fourth, and so on
MIN_FRAMES = 10  # From here on, the last fifth of a recording is kept apart: half of it calibrates, half judges
GAP_NS = 500_000_000  # Time between frames to learn from and those kept apart, because neighbours look the same

EVERYWHERE = 1e5 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


def read_recordings(
    recordings: Sequence[str],
    folder: Path,
    *,
    check: Callable[[Config], object],
    progress: Callable[[float, str], object],
    own_labels: bool = False,
    **options: Unpack[JobOptions],
) -> Recordings:
    """Read recordings to learn from, and keep a part of each apart.

    Args:
        recordings: Names of the recordings.
        folder: Empty folder for the frames.
        check: Raises if the settings of a recording do not fit.
        progress: Called with each recording before it is read.
        own_labels: Whether to process the recordings, and to learn from sure tracks in place of ground truth.
        **options: As in `lidcam.process`; `settings` is a sequence.

    Raises:
        LidcamError: a recording cannot be read, has no truth, or there are too few frames.
    """
    options["settings"] = (*options.get("settings", ()), *(TRACKS if own_labels else LIDARS_ONLY))
    names: list[str] = []
    parts: tuple[list[Path], ...] = [], [], []
    found_count = 0
    for number, recording in enumerate(recordings):
        progress(number / len(recordings), f"reading {recording}")
        own = folder / str(number)
        own.mkdir()
        kept = _Kept(recording, own, check, own_labels)
        summary = process_recording(make_job(recording, own / "result.mcap", **options), kept)
        names += [f"{file.name}, SHA-256\n  {file.sha256 or 'not known'}" for file in summary.inputs.files]
        frames = kept.labelled()
        found_count += len(frames)
        for part, found in zip(parts, _parted(frames), strict=True):
            part += found
    train, calibrate, judge = map(tuple, parts)
    if not (train and calibrate):
        apart = len(calibrate) + len(judge)
        raise RecordingError(
            f"{', '.join(recordings)}: expected a recording of {MIN_FRAMES} labelled frames or more, of which the "
            f"last fifth is kept apart, and a gap of {GAP_NS / 1e9:g} s before it left out; found {found_count} in "
            f"all, {len(train)} to learn from and {apart} kept apart; give a longer one"
        )
    objects = _objects_of(train)
    if own_labels and len(objects.true.yaws) < MIN_LABELS:
        raise RecordingError(
            f"{', '.join(recordings)}: nothing to learn from: expected {MIN_LABELS} boxes of sure tracks or more, "
            f"found {len(objects.true.yaws)} in {len(train)} frames; keep the network that is there, or give longer "
            "recordings"
        )
    return Recordings(train, calibrate, judge, saved(folder / "objects", objects), tuple(names))


def _parted(frames: Sequence[tuple[int, Path]]) -> tuple[list[Path], list[Path], list[Path]]:
    """Split frames in order of time into blocks to learn from, calibrate and judge by, as neighbours look the same."""
    half = len(frames) // MIN_FRAMES
    first = len(frames) - 2 * half
    paths = [path for _, path in frames]
    end_ns = frames[first][0] - GAP_NS if half else np.inf
    train = [path for stamp_ns, path in frames[:first] if stamp_ns < end_ns]
    return train, paths[first : first + half], paths[first + half :]


class _Kept(RunObserver):
    """Keeps the points of each frame of a run in files, and then the objects that are its labels."""

    def __init__(self, recording: str, folder: Path, check: Callable[[Config], object], own_labels: bool) -> None:
        self._recording, self._folder, self._check, self._own_labels = recording, folder, check, own_labels
        self._every = 1
        self._points: PillarPoints
        self._rig: Rig

    def opened(self, source: RunInput) -> None:
        self._check(source.config)
        if not (source.copied or self._own_labels):
            raise RecordingError(f"{self._recording}: expected topics of truth to learn from, found none")
        self._rig, self._points = source.rig, PillarPoints(source.rig, source.config)

    def frame(self, result: Frame) -> None:
        one, index = result.combined, result.bundle.index
        if index % self._every:
            return
        needed = replace(
            one, cloud=one.detection_cloud, ground_cloud=one.ground_cloud.select(np.arange(0)), ground_lidar_index=None
        )
        saved(self._path(index), needed)
        if index >= MAX_FRAMES * self._every:
            for dropped in range(self._every, index + 1, 2 * self._every):
                self._path(dropped).unlink(missing_ok=True)
            self._every *= 2

    def _path(self, index: int) -> Path:
        return self._folder / f"{index}.cloud"

    def labelled(self) -> list[tuple[int, Path]]:
        """The stamps and files of the frames that have labels; removes the result of the run."""
        out, frames = self._folder / "result.mcap", []
        with open_result(out) as result:
            for index, truth in tracked_objects(result.frames) if self._own_labels else _true_objects(result):
                path = self._path(index)
                if not path.exists():
                    continue
                with path.open("rb", buffering=0) as file:
                    combined = cast(CombinedCloud, load(file))
                path.unlink()
                if truth is not None:
                    found = self._labelled(combined, truth, result.config)
                    frames.append((truth.stamp_ns, saved(path.with_suffix(".frame"), found)))
        out.unlink()
        return frames

    def _labelled(self, combined: CombinedCloud, truth: TruthBoxes3D, config: Config) -> LabelledFrame:
        middle, names, rules = self._points.middle_xy, config.class_id_of_label, config.evaluate

        def from_middle(xyz: F64) -> F64:
            moved: F64 = xyz - np.append(middle, 0.0)
            moved[:, 2] -= self._points.ground_m(combined, moved[:, :2])
            return moved

        rows = {names[name]: row for row, name in reversed([*enumerate(NAMES)]) if name in names}
        classes = np.array([rows.get(one, -1) for one in truth.class_ids.tolist()], np.int64)
        counted = is_evaluated(truth, rules) & (classes >= 0)
        every = TrueBoxes(from_middle(truth.centers), truth.sizes, truth.yaws, classes, np.zeros_like(classes))
        circles = np.column_stack([every.centers[:, :2], np.linalg.norm(every.sizes[:, :2], axis=1) / 2])
        position, true = self._points(combined), every.select(counted)
        points = np.bincount(points_in_boxes(position, true)[1], minlength=len(true.yaws))
        return LabelledFrame(
            position,
            combined.detection_lidar_index,
            from_middle(self._rig.lidar_xyz),
            true._replace(points=points),
            circles[~counted],
            np.array(rules.region) - middle if isinstance(rules.region, tuple) else EVERYWHERE,
            np.append(-middle, rules.max_range_m or np.inf),
        )


def _true_objects(result: Result) -> Iterator[tuple[int, TruthBoxes3D | None]]:
    """The numbers of the frames, and the ground truth at their times."""
    with open_truth(result) as truth:
        yield from ((frame.index, frame.truth) for frame in EvaluationFrames(result, truth))


def tracked_objects(frames: Callable[[], Iterable[ResultFrame]]) -> Iterator[tuple[int, TruthBoxes3D]]:
    """The numbers of the frames, and the objects of sure tracks. All others are marked as ignored.

    Args:
        frames: Gives the frames of a result; called twice.
    """
    counts: Counter[int] = Counter()
    for frame in frames():
        fused = frame.sources["fused"]
        is_seen = ~fused.motion.is_predicted if fused.motion is not None else np.ones(len(fused), np.bool_)
        counts.update(fused.track_ids[is_seen].tolist())
    yield from ((frame.index, _sure(frame, counts)) for frame in frames())


def _sure(frame: ResultFrame, counts: Mapping[int, int]) -> TruthBoxes3D:
    fused = frame.sources["fused"]
    boxes, track_ids = fused.boxes, fused.track_ids
    seen = np.array([counts.get(track, 0) for track in track_ids.tolist()], np.int64)
    is_sure = (boxes.scores >= MIN_SURE_SCORE) & (seen >= MIN_SURE_FRAMES) & (track_ids != UNKNOWN)
    unknown = np.full(len(boxes), UNKNOWN, np.int32)
    columns = boxes.centers, boxes.sizes, boxes.yaws, boxes.class_ids, np.full(len(boxes), "")
    return TruthBoxes3D(
        frame.stamp_ns, boxes.frame_id, *columns, np.full(len(boxes), UNKNOWN), unknown, unknown, ~is_sure
    )


def _objects_of(frames: Sequence[Path]) -> Objects:
    """The objects in frames that have enough points to be put into other frames."""
    parts, position, lidar = [], [], []
    for path in frames:
        frame = loaded(path)
        chosen = frame.true.select(frame.true.points >= MIN_PASTED_POINTS)
        rows, box = points_in_boxes(frame.position, chosen)
        ends = np.searchsorted(box, np.arange(1, len(chosen.yaws)))
        parts.append(chosen)
        if len(chosen.yaws):
            position += [one.astype(np.float32) for one in np.split(frame.position[rows], ends)]
            lidar += np.split(frame.lidar[rows], ends)
    return Objects(TrueBoxes.joined(parts), position, lidar)
