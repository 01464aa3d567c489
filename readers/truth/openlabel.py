"""Truth from OpenLABEL files: cuboids of a sequence in one file, or of a frame in each file of a folder.

Frames with timestamps are brought to the time that is asked for, others belong to the result's frames by their number.
"""

from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import TruthBoxes3D
from lidcam.readers.messages.objects.found import check_boxes
from lidcam.readers.truth.boxes import Labelled, label_files, truth_boxes_3d
from lidcam.readers.truth.moment import STEP_BACK_NS, Moment
from lidcam.readers.truth.openlabel_text import Cuboid, OpenLabel, OpenLabelFrame, read_openlabel
from lidcam.readers.truth.source import TruthSource
from lidcam.readers.truth.timeline import Timeline


def is_openlabel(head: str) -> bool:
    """Whether a file that begins like this may be OpenLABEL: a JSON object."""
    return head.lstrip().startswith("{")


class OpenLabelTruth(TruthSource):
    """The cuboids of OpenLABEL as a source of truth; see `TruthSource`.

    Args:
        path: A file, or a folder of .json files, which are taken in the order of their numbers.
        rig: The rig of the result; its frames and sensors are found by name among the coordinate systems.
        config: Classes.

    Raises:
        RecordingError: a file cannot be read, has no frames, or does not say which coordinate system is meant.
    """

    def __init__(self, path: Path, rig: Rig, config: Config) -> None:
        self._files = label_files(path, "json") if path.is_dir() else [path]
        self._rig, self._class_ids, self._limits = rig, config.class_id_of_label, config.limits
        self._tracks: dict[str, int] = {}
        self._known: Mapping[str, F64] = _frames_of(rig)
        self._without = 0
        self.description = f"OpenLABEL of {path}"
        frames = self._frames()
        first = next(frames, None)
        if first is None:
            raise RecordingError(f"{path}: expected OpenLABEL with frames, found none")
        self._has_stamps = first[1].frame_properties.timestamp is not None
        self._left = chain((first,), frames)
        self._timeline, self._moments = Timeline(), self._stamped()
        self._current: tuple[int, OpenLabelFrame, OpenLabel] | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """See `TruthSource`."""
        notes = []
        if not self._has_stamps:
            notes.append(f"{self.description}: no timestamps, matched with the frames of the result by their numbers")
        if self._without:
            notes.append(f"{self.description}: {self._without} objects without a cuboid are not used")
        return tuple(notes)

    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        """See `TruthSource`: the objects in the site frame, or in a frame that the rig does not know."""
        if self._has_stamps:
            return self._at_time(stamp_ns)
        while self._current is None or self._current[0] < frame:
            following = next(self._left, None)
            if following is None:
                break
            self._current = following
        if self._current is None or self._current[0] != frame:
            return None
        return self._boxes(stamp_ns, *self._current)

    def _frames(self) -> Iterator[tuple[int, OpenLabelFrame, OpenLabel]]:
        """Number, frame and file; in a folder frames are counted, in a file they have numbers."""
        count = 0
        for path in self._files:
            file = read_openlabel(path)
            for number in sorted(file.frames):
                check_boxes(file.object_keys(number), f"{path}: frame {number}", self._limits)
                frame = file.frame(number, path)
                self._without += sum(not one.object_data.cuboid for one in frame.objects.values())
                yield (number if len(self._files) == 1 else count), frame, file
                count += 1

    def _at_time(self, stamp_ns: int) -> TruthBoxes3D | None:
        """The objects at a time, between two frames."""
        while not self._timeline.reaches(stamp_ns) and (moment := next(self._moments, None)) is not None:
            if not self._timeline.add(moment):
                raise RecordingError(f"{self.description}: its timestamps step back at {moment.stamp_ns} ns")
            self._timeline.forget(stamp_ns - STEP_BACK_NS)
        found = self._timeline.at(stamp_ns)
        return None if found is None else found.boxes

    def _stamped(self) -> Iterator[Moment]:
        for number, frame, file in self._left:
            stamp_ns = frame.frame_properties.timestamp
            if stamp_ns is None:
                raise RecordingError(f"{self.description}: frame {number} has no timestamp, others have")
            yield Moment(self._boxes(stamp_ns, number, frame, file))

    def _boxes(self, stamp_ns: int, number: int, frame: OpenLabelFrame, file: OpenLabel) -> TruthBoxes3D:
        frame_id = self._rig.site_frame
        objects = []
        for uuid, data in ((uuid, one.object_data) for uuid, one in frame.objects.items() if one.object_data.cuboid):
            cuboid = data.cuboid[0]
            system = cuboid.coordinate_system or self._default_system(file)
            T_site_system = self._placed(system, file)
            if T_site_system is None:
                frame_id, T_site_system = system, np.eye(4)
            objects.append((system, self._labelled(uuid, file.label_of(uuid, data), cuboid, T_site_system)))
        if frame_id != self._rig.site_frame and (other := {system for system, _ in objects} - {frame_id}):
            raise RecordingError(
                f"{self.description}: frame {number} has boxes in {frame_id!r}, which nothing joins with "
                f"{', '.join(sorted(other))}"
            )
        return truth_boxes_3d(stamp_ns, frame_id, [one for _, one in objects], self._class_ids)

    def _labelled(self, uuid: str, label: str, cuboid: Cuboid, T_site_system: F64) -> Labelled:
        track_id = self._tracks.setdefault(uuid, len(self._tracks))
        return Labelled(label, T_site_system @ cuboid.T_system_box(), cuboid.size_m, track_id, cuboid.lidar_points)

    def _default_system(self, file: OpenLabel) -> str:
        """The coordinate system of cuboids that name none."""
        names = [*file.coordinate_systems]
        lidars = {name for lidar in self._rig.lidars for name in (lidar.name, lidar.T_site_lidar.src)}
        for found in (names, [name for name in names if name in lidars]):
            if len(found) == 1:
                return found[0]
        if not names:
            return self._rig.site_frame
        raise RecordingError(
            f"{self.description}: its cuboids name no coordinate system, and not one of {', '.join(names)} is a lidar "
            f"of the rig ({', '.join(sorted(lidars))})"
        )

    def _placed(self, system: str, file: OpenLabel) -> F64 | None:
        """T_site_system, over the file's poses where the rig knows another system; None if nothing joins them."""
        if system in self._known:
            return self._known[system]
        from_root = {name: found for name in file.coordinate_systems if (found := _from_root(name, file)) is not None}
        if system not in from_root:
            return None
        root, T_root_system = from_root[system]
        for name, (other_root, T_root_other) in from_root.items():
            if other_root == root and name in self._known:
                placed: F64 = self._known[name] @ np.linalg.inv(T_root_other) @ T_root_system
                return placed
        return None


def _frames_of(rig: Rig) -> dict[str, F64]:
    """T_site_frame by the names of the rig's frames and sensors."""
    known: dict[str, F64] = {}
    for camera in rig.cameras:
        for name in (camera.name, camera.T_camera_site.dst):
            known[name] = camera.T_camera_site.inverse().matrix
    for lidar in rig.lidars:
        for name in (lidar.name, lidar.T_site_lidar.src):
            known[name] = lidar.T_site_lidar.matrix
    return known | {rig.site_frame: np.eye(4)}


def _from_root(name: str, file: OpenLabel) -> tuple[str, F64] | None:
    """The root above a coordinate system, and T_root_system; None if its parents form a circle."""
    pose: F64 = np.eye(4)
    seen = {name}
    while (system := file.coordinate_systems.get(name)) and system.parent and system.pose_wrt_parent:
        pose, name = system.pose_wrt_parent.matrix() @ pose, system.parent
        if name in seen:
            return None
        seen.add(name)
    return name, pose
