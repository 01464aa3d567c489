"""Truth from the odometry of vehicles whose boxes the rig file gives."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ConfigError, FrameError, MessageError, RecordingError
from lidcam.pipeline.core.geometry.pose_samples import interpolate_poses
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import TruthVehicle
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import TruthBoxes3D
from lidcam.readers.messages.tf import ODOMETRY, RecordedTransforms, decode_odometry
from lidcam.readers.notes import Notes
from lidcam.readers.recording import Recording
from lidcam.readers.truth.boxes import Labelled, truth_boxes_3d
from lidcam.readers.truth.moment import STEP_BACK_NS
from lidcam.readers.truth.source import TruthSource

MAX_GAP_NS = 1_000_000_000
"""Largest gap between two poses that are interpolated."""

MAX_LEAD_NS = 5_000_000_000
"""Longest time that the messages of one vehicle are read ahead of a silent one."""


@dataclass(slots=True)
class _Track:
    """The last poses of one vehicle, in the order of their stamps."""

    stamps_ns: deque[int] = field(default_factory=deque)
    poses: deque[F64] = field(default_factory=deque)
    frame_id: str = ""

    def add_pose(self, stamp_ns: int, frame_id: str, pose: F64) -> str:
        """Why a pose is not used; empty if it is."""
        if self.stamps_ns and stamp_ns <= self.stamps_ns[-1]:
            return "stamp not after that of the message before"
        if self.frame_id and frame_id != self.frame_id:
            return f"pose in {frame_id!r}, expected {self.frame_id!r} as in the first message"
        self.frame_id = frame_id
        self.stamps_ns.append(stamp_ns)
        self.poses.append(pose)
        return ""

    def forget(self, before_ns: int) -> None:
        """Forget the poses that no time from `before_ns` on needs."""
        while len(self.stamps_ns) > 1 and self.stamps_ns[1] <= before_ns:
            self.stamps_ns.popleft()
            self.poses.popleft()

    def at(self, stamp_ns: int) -> F64 | None:
        """(4, 4) pose at a time; None if it is not between two poses that are near each other."""
        after = next((row for row, known in enumerate(self.stamps_ns) if known >= stamp_ns), None)
        if after is None:
            return None
        if self.stamps_ns[after] == stamp_ns:
            return self.poses[after]
        if after == 0 or self.stamps_ns[after] - self.stamps_ns[after - 1] > MAX_GAP_NS:
            return None
        stamps_ns = np.array([self.stamps_ns[after - 1], self.stamps_ns[after]], np.int64)
        poses = np.stack([self.poses[after - 1], self.poses[after]])
        found: F64 = interpolate_poses(stamps_ns, poses, np.array([stamp_ns], np.int64))[0]
        return found


class OdometryTruth(TruthSource):
    """The boxes of the vehicles whose odometry was recorded; see `TruthSource`.

    A moment is covered if the poses of all vehicles are known at it, interpolated between two messages.

    `recording` has the odometry: the recording, or a result that its topics were copied to. `transforms` join the
    frames in which vehicles move, where these are several. Raises RecordingError if a topic was not recorded, or is no
    odometry, and ConfigError if a vehicle is of no configured class.
    """

    def __init__(
        self, recording: Recording, vehicles: Mapping[str, TruthVehicle], transforms: RecordedTransforms, config: Config
    ) -> None:
        recorded = {info.topic: info for info in recording.topics if info.message_count and not info.unreadable}
        for name, vehicle in vehicles.items():
            found = recorded.get(vehicle.topic)
            if found is None or found.msgtype != ODOMETRY:
                names = ", ".join(sorted(one.topic for one in recorded.values() if one.msgtype == ODOMETRY)) or "none"
                what = "no such topic" if found is None else found.msgtype
                raise RecordingError(
                    f"{', '.join(map(str, recording.paths))}: truth.{name} of the rig: expected {ODOMETRY} on "
                    f"{vehicle.topic}, found {what}; recorded odometry: {names}"
                )
        self._class_ids = config.class_id_of_label
        for name, vehicle in vehicles.items():
            if vehicle.label.strip().lower() not in self._class_ids:
                raise ConfigError(
                    f"truth.{name}.class of the rig: expected a class of the settings, or a label of one "
                    f"({', '.join(self._class_ids)}), found {vehicle.label!r}"
                )
        self._vehicles, self._transforms = dict(vehicles), transforms
        self._limits = config.limits
        self._names: dict[str, list[str]] = {}
        for name, vehicle in vehicles.items():
            self._names.setdefault(vehicle.topic, []).append(name)
        self._tracks = {topic: _Track() for topic in self._names}
        self._messages: Iterator[RawMessage] | None = recording.messages(self._names)
        self._notes = Notes()
        self.description = f"odometry {', '.join(self._names)} of {', '.join(path.name for path in recording.paths)}"

    @property
    def notes(self) -> tuple[str, ...]:
        """See `TruthSource`."""
        return self._notes.lines()

    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        """See `TruthSource`: the boxes in the frame that the vehicles move in."""
        del frame
        self._read_to(stamp_ns)
        objects = []
        frame_id = ""
        for row, vehicle in enumerate(self._vehicles.values()):
            track = self._tracks[vehicle.topic]
            pose = track.at(stamp_ns)
            if pose is None:
                return None
            frame_id = frame_id or track.frame_id
            if track.frame_id != frame_id:
                pose = self._joined(frame_id, track.frame_id) @ pose
            T_fixed_box = pose.copy()
            T_fixed_box[:3, 3] += pose[:3, :3] @ np.array(vehicle.offset_m)
            objects.append(Labelled(vehicle.label, T_fixed_box, vehicle.size_m, track_id=row))
        return truth_boxes_3d(stamp_ns, frame_id, objects, self._class_ids)

    def _joined(self, frame_id: str, other: str) -> F64:
        try:
            return self._transforms.lookup(frame_id, other).matrix
        except FrameError as err:
            raise RecordingError(
                f"{self.description}: the vehicles move in {frame_id!r} and {other!r}, which no fixed transform joins: "
                f"{err}"
            ) from err

    def _read_to(self, stamp_ns: int) -> None:
        """Read until all vehicles' poses after a time are known, or one is known long after it."""
        for track in self._tracks.values():
            track.forget(stamp_ns - STEP_BACK_NS)
        while self._messages is not None and not self._is_known(stamp_ns):
            message = next(self._messages, None)
            if message is None:
                self._messages = None
                return
            self._take(message)

    def _is_known(self, stamp_ns: int) -> bool:
        lasts = [track.stamps_ns[-1] if track.stamps_ns else -1 for track in self._tracks.values()]
        return min(lasts) >= stamp_ns or max(lasts) >= stamp_ns + MAX_LEAD_NS

    def _take(self, message: RawMessage) -> None:
        try:
            pose = decode_odometry(message, limits=self._limits)
        except MessageError as err:
            fault = str(err)
        else:
            fault = self._tracks[message.topic].add_pose(message.stamp_ns, pose.dst, pose.matrix)
        if fault:
            self._notes.add_note(f"messages of {message.topic} that are not used", fault)
