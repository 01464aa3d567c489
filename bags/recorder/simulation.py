"""A scenario as a stream of messages: everything moves, every sensor measures in its time, step by step.

The messages are the same whatever the steps and the number of workers: each measurement depends on the scenario, the
seed and its own number alone.
"""

import os
from collections import deque
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bags.recorder.message_types import RosVersion
from bags.recorder.messages import MessageFactory, TrueObject
from bags.recorder.true_rig import EGO_FRAME, carrier_frame, recorded_extrinsics, true_rig
from bags.scenario import CameraScenario, LidarScenario, Scenario, SensorScenario
from bags.sensors.camera import Camera
from bags.sensors.detector2d import detect
from bags.sensors.lidar import Lidar, Sweep
from bags.sensors.timing import Measurement, Timing
from bags.vehicles.ackermann import command_topic, controller_topics
from bags.vehicles.traffic import Traffic
from bags.vehicles.trajectory import Trajectory
from bags.world.motion import FixedPath, MountedPath, Path
from bags.world.places import ground_height, static_mesh
from bags.world.scene import Scene
from bags.world.shapes import SHAPES, build_mover
from pipeline.geometry import Transform
from pipeline.types import Rig

__all__ = ["STEP_NS", "TRUTH_TOPIC", "Recorded", "Simulation"]

I64 = npt.NDArray[np.int64]

STEP_NS = 100_000_000
"""How far the simulation goes at a time, where nobody asks for another step."""

TRUTH_TOPIC = "/ground_truth/objects"

LATENCY_NS = 1_000_000
"""From a vehicle's state to its message in the recording."""

TURN_NS = 10_000_000
"""Over which the rate of turn is taken."""

KEPT_NS = 1_000_000_000
"""How long the past is kept beyond what measurements under way need."""


class Recorded(NamedTuple):
    """One message as it is recorded; in the order of these fields.

    Attributes:
        log_ns: True time since the scenario began.
        topic: Where.
        stamp_ns: Of its header, or as `log_ns` where it has none.
        message: The object.
        latched: Whether late subscribers get it, too.
    """

    log_ns: int
    topic: str
    stamp_ns: int
    message: Any
    latched: bool = False


@dataclass(slots=True)
class _Channel:
    """One sensor at work.

    Attributes:
        timing: Its clock.
        device: What measures.
        next: Its next measurement.
        hits: Of its last measurements: from when to when they stand for what is there, and hits per mover.
    """

    timing: Timing
    device: Lidar | Camera
    next: Measurement
    hits: deque[tuple[int, int, I64]] = field(default_factory=deque)


class Simulation:
    """A scenario in motion.

    Args:
        scenario: What is simulated.
        ros_version: Whose messages.
        seed: Instead of the scenario's own.
        workers: Sensors that measure at once; None: as many as there are cores.
        driven: Vehicles that stand at their start until `traffic.command` moves them.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        ros_version: RosVersion,
        seed: int | None = None,
        workers: int | None = None,
        driven: Collection[str] = (),
    ) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self.messages = MessageFactory(ros_version, scenario.start_ns)
        world = static_mesh(scenario.world)
        self.traffic = Traffic(scenario, driven=driven, static=world)
        self._vehicles = {name: vehicle for name, vehicle in scenario.vehicles.items() if not vehicle.ego}
        trajectories = self.traffic.trajectories
        height = partial(ground_height, scenario.world)
        movers = [
            build_mover(name, vehicle, trajectories[name], height=height) for name, vehicle in self._vehicles.items()
        ]
        self._paths: dict[str, Path] = dict(trajectories) | {mover.name: mover.path for mover in movers}
        self.scene = Scene(world, movers)
        self._channels = [
            *(self._lidar(name, lidar) for name, lidar in scenario.lidars.items()),
            *(self._camera(name, camera) for name, camera in scenario.cameras.items()),
        ]
        self._workers = os.cpu_count() or 1 if workers is None else workers
        self._now_ns = -1
        self._waiting: list[Recorded] = [self._static_transforms()]
        self._truths: deque[int] = deque()
        periods = [channel.timing.period_ns for channel in self._channels]
        # A tenth more: jitter, and sweeps that hold whole packets.
        self._longest_ns = max(periods, default=STEP_NS) * 11 // 10

    @property
    def now_ns(self) -> int:
        """How far it has gone."""
        return max(self._now_ns, 0)

    @property
    def cameras(self) -> dict[str, Camera]:
        """By name."""
        return {channel.timing.name: channel.device for channel in self._channels if isinstance(channel.device, Camera)}

    @property
    def true_rig(self) -> Rig:
        """The calibration as it really is."""
        return true_rig(self.scenario, {name: camera.model for name, camera in self.cameras.items()})

    def run(self, duration_s: float) -> Iterator[list[Recorded]]:
        """The messages of a whole recording, a step at a time, in the order in which they are recorded.

        What was measured before the end is recorded, also where that takes longer.
        """
        end_ns = round(duration_s * 1e9)
        with ThreadPoolExecutor(self._workers) as pool:
            while self._now_ns < end_ns:
                yield self.step(min(max(self._now_ns, 0) + STEP_NS, end_ns), pool)
        yield self.rest()

    def step(self, until_ns: int, pool: ThreadPoolExecutor) -> list[Recorded]:
        """Go on to a moment; what was recorded until then."""
        begin_ns, self._now_ns = self._now_ns, until_ns
        self.traffic.advance(until_ns)
        jobs = [(channel, measurement) for channel in self._channels for measurement in self._due(channel, until_ns)]
        for (channel, measurement), (found, hits) in zip(jobs, pool.map(self._measure, jobs), strict=True):
            self._waiting += found
            # A picture stands for the time that is nearer to it than to the next one.
            half_ns = channel.timing.period_ns // 2 if isinstance(channel.device, Camera) else 0
            channel.hits.append((measurement.begin_ns - half_ns, measurement.end_ns + half_ns, hits))
        self._waiting += self._states(begin_ns, until_ns)
        self._truths += _moments(self.scenario.recording.truth_rate_hz, begin_ns, until_ns)
        while self._truths and self._truths[0] + self._longest_ns <= until_ns:
            self._waiting.append(self._truth(self._truths.popleft()))
        self._forget(until_ns)
        self._waiting.sort(key=lambda recorded: recorded[:3])
        ready = sum(recorded.log_ns <= until_ns for recorded in self._waiting)
        done, self._waiting = self._waiting[:ready], self._waiting[ready:]
        return done

    def rest(self) -> list[Recorded]:
        """What was measured and not yet recorded; the end."""
        done, self._waiting = self._waiting, []
        return done

    # --- sensors

    def _path(self, sensor: SensorScenario) -> Path:
        """Of the sensor's body, x forward."""
        place = sensor.T_carrier_body(carrier_frame(self.scenario, sensor))
        return (
            MountedPath(self.traffic.trajectories[sensor.mounted_on], place) if sensor.mounted_on else FixedPath(place)
        )

    def _lidar(self, name: str, lidar: LidarScenario) -> _Channel:
        device = Lidar(name, lidar, self._path(lidar), self.scene, self.seed)
        timing = Timing(name, lidar, self.seed, trigger_jitter=False)
        return _Channel(timing, device, _measurement(timing, device, 0))

    def _camera(self, name: str, camera: CameraScenario) -> _Channel:
        device = Camera(name, camera, self._path(camera), self.scene, self.scenario.sun, self.seed)
        timing = Timing(name, camera, self.seed, trigger_jitter=True)
        return _Channel(timing, device, _measurement(timing, device, 0))

    def _due(self, channel: _Channel, until_ns: int) -> Iterator[Measurement]:
        """The measurements of a sensor that have ended by then."""
        while channel.next.end_ns <= until_ns and channel.timing.is_alive(channel.next.begin_ns):
            yield channel.next
            channel.next = _measurement(channel.timing, channel.device, channel.next.number + 1)

    def _measure(self, job: tuple[_Channel, Measurement]) -> tuple[list[Recorded], I64]:
        """The messages of one measurement, and how often it hit each mover; a lost one has neither."""
        channel, measurement = job
        if measurement.lost:
            return [], np.zeros(len(self.scene.movers), np.int64)
        if isinstance(channel.device, Lidar):
            return self._sweep(channel.timing.name, channel.device, measurement)
        return self._picture(channel.timing.name, channel.device, measurement)

    def _sweep(self, name: str, device: Lidar, measurement: Measurement) -> tuple[list[Recorded], I64]:
        lidar = self.scenario.lidars[name]
        sweep = device.sweep(measurement.number)
        stamp_ns, found = measurement.stamp_ns, []
        if lidar.output != "packets":
            cloud = self.messages.cloud(stamp_ns, lidar.frame_id, _cloud_fields(sweep))
            found.append(Recorded(measurement.log_ns, lidar.topic, stamp_ns, cloud))
        if sweep.packets is not None:
            # What is in a packet is told by the sensor's clock, too.
            packets = sweep.packets.later(self.scenario.start_ns + stamp_ns - measurement.begin_ns)
            scan = self.messages.scan(
                stamp_ns, lidar.frame_id, packets.stamps_ns - self.scenario.start_ns, packets.payload
            )
            found.append(Recorded(measurement.log_ns, lidar.packets_topic, stamp_ns, scan))
        return found, sweep.hits_per_mover

    def _picture(self, name: str, device: Camera, measurement: Measurement) -> tuple[list[Recorded], I64]:
        camera, stamp_ns, log_ns = self.scenario.cameras[name], measurement.stamp_ns, measurement.log_ns
        picture = device.picture(measurement.number, measurement.begin_ns)
        frame_id = device.model.frame_id
        if camera.output == "jpeg":
            message = self.messages.jpeg(stamp_ns, frame_id, picture.rgb, camera.jpeg_quality)
            found = [Recorded(log_ns, f"{camera.topic}/compressed", stamp_ns, message)]
        else:
            found = [Recorded(log_ns, camera.topic, stamp_ns, self.messages.image(stamp_ns, frame_id, picture.rgb))]
        found.append(Recorded(log_ns, camera.info_topic, stamp_ns, self.messages.camera_info(stamp_ns, device.model)))
        if camera.detector is not None:
            boxes = detect(device, picture, camera.detector, measurement.number)
            detections = self.messages.detections_2d(stamp_ns, frame_id, boxes.xyxy, boxes.scores, boxes.class_names)
            late_ns = log_ns + round(camera.detector.delay_ms * 1e6)
            found.append(Recorded(late_ns, camera.detector.topic, stamp_ns, detections))
        return found, picture.seen_px

    # --- what is known without sensors

    def _static_transforms(self) -> Recorded:
        return Recorded(0, "/tf_static", 0, self.messages.transforms(0, recorded_extrinsics(self.scenario)), True)

    def _states(self, begin_ns: int, until_ns: int) -> Iterator[Recorded]:
        """Odometry, tf and commands of the vehicles."""
        settings = self.scenario.recording
        for name, vehicle in self.scenario.vehicles.items():
            for time_ns in _moments(settings.odometry_rate_hz, begin_ns, until_ns):
                if vehicle.ego:
                    yield from self._ego_motion(name, time_ns, odometry=vehicle.odometry)
                elif vehicle.odometry:
                    topic = f"/{name}/base_pose_ground_truth"
                    yield Recorded(time_ns + LATENCY_NS, topic, time_ns, self._odometry(name, time_ns))
            if vehicle.commands:
                for time_ns in _moments(settings.command_rate_hz, begin_ns, until_ns):
                    yield from self._commands(name, time_ns)

    def _ego_motion(self, name: str, time_ns: int, *, odometry: bool) -> Iterator[Recorded]:
        state = self.traffic.trajectories[name].state(time_ns)
        pose = self._T_site_base(name, EGO_FRAME, time_ns)
        yield Recorded(time_ns + LATENCY_NS, "/tf", time_ns, self.messages.transforms(time_ns, [pose]))
        if odometry:
            velocity = (state.speed_m_s, 0.0, self._turn_rad_s(name, time_ns))
            yield Recorded(time_ns + LATENCY_NS, "/odom", time_ns, self.messages.odometry(time_ns, pose, velocity))

    def _odometry(self, name: str, time_ns: int) -> Any:
        """The pose of the middle of a vehicle's box, as the original's ground truth has it."""
        shape, turn = SHAPES[self.scenario.vehicles[name].shape], self._turn_rad_s(name, time_ns)
        pose = self._T_site_box(name, f"{name}/base_link", time_ns)
        speed = self.traffic.trajectories[name].state(time_ns).speed_m_s
        return self.messages.odometry(time_ns, pose, (speed, turn * shape.box_center_m[0], turn))

    def _turn_rad_s(self, name: str, time_ns: int) -> float:
        path: Trajectory = self.traffic.trajectories[name]
        before, after = path.state(max(time_ns - TURN_NS, 0)), path.state(time_ns)
        return (after.yaw_rad - before.yaw_rad) / (TURN_NS * 1e-9)

    def _commands(self, name: str, time_ns: int) -> Iterator[Recorded]:
        """What the driver asks for, and what that makes of the six controllers."""
        command = self.traffic.command_at(name, time_ns)
        frame_id = f"{name}/base_link"
        drive = self.messages.drive(time_ns, frame_id, speed_m_s=command.speed_m_s, steering_rad=command.steering_rad)
        yield Recorded(time_ns + LATENCY_NS, command_topic(name), time_ns, drive)
        values = self.traffic.chassis[name].controllers(command).values
        for topic, value in zip(controller_topics(name), values, strict=True):
            yield Recorded(time_ns + 2 * LATENCY_NS, topic, time_ns, self.messages.number(value))

    # --- truth

    def _truth(self, time_ns: int) -> Recorded:
        """What is there at a moment, recorded when every sensor that was measuring then has finished."""
        counts = {Lidar: self._hits(Lidar, time_ns), Camera: self._hits(Camera, time_ns)}
        objects = [
            TrueObject(
                name,
                SHAPES[vehicle.shape].class_name,
                self._T_site_box(name, name, time_ns),
                SHAPES[vehicle.shape].size_m,
                int(counts[Lidar][row]),
                int(counts[Camera][row]),
            )
            for row, (name, vehicle) in enumerate(self._vehicles.items())
        ]
        message = self.messages.truth(time_ns, self.scenario.site_frame, objects)
        return Recorded(time_ns + self._longest_ns, TRUTH_TOPIC, time_ns, message)

    def _hits(self, kind: type[Lidar] | type[Camera], time_ns: int) -> I64:
        """Hits per mover in the measurements of one kind of sensor that stand for a moment."""
        total = np.zeros(len(self.scene.movers), np.int64)
        for channel in self._channels:
            if isinstance(channel.device, kind):
                for begin_ns, end_ns, hits in channel.hits:
                    if begin_ns <= time_ns < end_ns:
                        total += hits
        return total

    def _T_site_base(self, name: str, frame: str, time_ns: int) -> Transform:
        pose = self._paths[name].poses(np.array([time_ns], np.int64))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = pose.rotation[0], pose.translation[0]
        return Transform(self.scenario.site_frame, frame, matrix)

    def _T_site_box(self, name: str, frame: str, time_ns: int) -> Transform:
        center = np.eye(4)
        center[:3, 3] = SHAPES[self.scenario.vehicles[name].shape].box_center_m
        base = self._T_site_base(name, frame, time_ns)
        return Transform(base.dst, frame, base.matrix @ center)

    def _forget(self, until_ns: int) -> None:
        """Let go of what no measurement or truth will ask for again."""
        kept_ns = until_ns - 2 * self._longest_ns - KEPT_NS
        self.traffic.forget(kept_ns)
        for channel in self._channels:
            while channel.hits and channel.hits[0][1] < kept_ns:
                channel.hits.popleft()


def _cloud_fields(sweep: Sweep) -> dict[str, npt.NDArray[Any]]:
    """The fields of the ROS velodyne driver: x y z intensity ring time; the kind of return, where there are two."""
    fields: dict[str, npt.NDArray[Any]] = {
        "x": sweep.xyz[:, 0],
        "y": sweep.xyz[:, 1],
        "z": sweep.xyz[:, 2],
        "intensity": sweep.intensity,
        "ring": sweep.ring,
        "time": sweep.time_offset_s,
    }
    return fields if sweep.return_type is None else fields | {"return_type": sweep.return_type}


def _measurement(timing: Timing, device: Lidar | Camera, number: int) -> Measurement:
    if isinstance(device, Lidar):
        return timing.measurement(number, begin_ns=device.begin_ns(number), end_ns=device.end_ns(number))
    return timing.measurement(number, lasts_ns=device.after_ns)


def _moments(rate_hz: float, begin_ns: int, until_ns: int) -> Iterator[int]:
    """Times of a steady rate after `begin_ns` up to `until_ns`; 0 is the first of all."""
    if rate_hz <= 0:
        return
    number = 0 if begin_ns < 0 else int(begin_ns * rate_hz / 1e9)
    while (time_ns := round(number * 1e9 / rate_hz)) <= until_ns:
        if time_ns > begin_ns:
            yield time_ns
        number += 1
