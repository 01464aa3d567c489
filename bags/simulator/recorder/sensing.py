"""Running sensors: their measurements up to a time, as messages."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.bags.simulator.recorder.messages import MessageFactory, ViewedObject, class_of, counted
from lidcam.bags.simulator.recorder.recorded import Measured, Recorded, SensingTask
from lidcam.bags.simulator.recorder.stage import Stage
from lidcam.bags.simulator.scenario.scenario import camera_truth_topics
from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario
from lidcam.bags.simulator.sensors.camera import Camera, CameraImage
from lidcam.bags.simulator.sensors.lidar import Lidar, Sweep
from lidcam.bags.simulator.sensors.timing import Measurement, Timing
from lidcam.bags.simulator.sensors.visibility import NO_MOVER, Detected, Visibility, detect, visibility
from lidcam.bags.simulator.world.motion import Mover
from lidcam.pipeline.core.arrays import F64, Array
from lidcam.pipeline.core.ros.vision_numbers import IMAGE_PIXELS


@dataclass(slots=True)
class _Sensor:
    """A running sensor: full name, timing, simulated device, next measurement."""

    name: str
    timing: Timing
    device: Lidar | Camera
    next: Measurement


class Sensing:
    """Some of a scenario's sensors; the stage's traffic must be advanced before they measure."""

    def __init__(self, stage: Stage, task: SensingTask) -> None:
        self._stage, self._seed, names = stage, task.scenario.seed, task.names
        self._messages = MessageFactory(task.ros_version, task.scenario.start_ns)
        self._sensors = [
            self._sensor(full_name, name, sensor)
            for full_name, sensor in stage.scenario.sensors.items()
            if (name := full_name.partition(".")[2]) in names
        ]

    def measure(self, until_ns: int, *, start_limit_ns: int) -> list[Measured]:
        """Measurements that ended since the last call and by `until_ns`, and began before `start_limit_ns`."""
        return [
            self._measured(sensor, one) for sensor in self._sensors for one in _due(sensor, until_ns, start_limit_ns)
        ]

    def _sensor(self, full_name: str, name: str, sensor: LidarScenario | CameraScenario) -> _Sensor:
        path, scene, seed = self._stage.sensor_path(sensor), self._stage.scene, self._seed
        timing = Timing(name, sensor, seed, trigger_jitter=isinstance(sensor, CameraScenario))
        device: Lidar | Camera
        if isinstance(sensor, LidarScenario):
            device = Lidar(name, sensor, path, scene, seed)
        else:
            device = Camera(name, sensor, path, scene, self._stage.scenario.sun, seed)
        return _Sensor(full_name, timing, device, _measurement(timing, device, 0))

    def _measured(self, sensor: _Sensor, measurement: Measurement) -> Measured:
        device, timing, number = sensor.device, sensor.timing, measurement.number
        times = measurement.begin_ns, measurement.end_ns
        if isinstance(device, Camera):
            # An image stands for the time that is nearer to it than to its neighbours; jitter and exposure do not move
            # it, so that each moment has one image.
            half_ns = timing.period_ns // 2
            times = timing.nominal_ns(number) - half_ns, timing.nominal_ns(number + 1) - half_ns
        none = np.zeros(len(self._stage.scene.movers), np.int64)
        if measurement.lost:
            return Measured(sensor.name, *times, none, none, ())
        if isinstance(device, Lidar):
            sweep = device.sweep(measurement.number)
            recorded = tuple(self._of_sweep(device.scenario, measurement, sweep))
            return Measured(sensor.name, *times, sweep.hits_per_mover, sweep.hit_offsets_ns, recorded)
        image = device.image(measurement.number, measurement.begin_ns)
        return Measured(sensor.name, *times, image.seen_px, none, tuple(self._of_image(device, measurement, image)))

    def _of_sweep(self, settings: LidarScenario, measurement: Measurement, sweep: Sweep) -> Iterator[Recorded]:
        stamp_ns, make = measurement.stamp_ns, self._messages
        if settings.output != "packets":
            cloud = make.cloud(stamp_ns, settings.frame_id, _cloud_fields(sweep))
            yield make.recorded(measurement.log_ns, settings.topic, stamp_ns, cloud)
        if sweep.packets is not None:
            # Times inside packets follow the sensor's clock, too.
            packets = sweep.packets.later(make.start_ns + stamp_ns - measurement.begin_ns)
            stamps_ns = packets.stamps_ns - make.start_ns
            scan = make.scan(stamp_ns, settings.frame_id, stamps_ns, packets.payload)
            yield make.recorded(measurement.log_ns, settings.packets_topic, stamp_ns, scan)

    def _of_image(self, camera: Camera, measurement: Measurement, image: CameraImage) -> Iterator[Recorded]:
        settings, stamp_ns, log_ns, make = camera.scenario, measurement.stamp_ns, measurement.log_ns, self._messages
        model = camera.model
        if settings.output == "jpeg":
            message = make.jpeg(stamp_ns, model.frame_id, image.rgb, settings.jpeg_quality)
        else:
            message = make.rgb_image(stamp_ns, model.frame_id, image.rgb)
        yield make.recorded(log_ns, settings.image_topic, stamp_ns, message)
        yield make.recorded(log_ns, settings.info_topic, stamp_ns, make.intrinsics(stamp_ns, model))
        movers, name = self._stage.scene.movers, camera.name
        if settings.detector is not None:
            classes = [mover.class_name for mover in movers]
            found = detect(settings.detector, image, classes, name=name, number=measurement.number, seed=self._seed)
            boxes = make.detections_2d(stamp_ns, model.frame_id, _detected_objects(found, movers))
            late_ns = log_ns + round(settings.detector.delay_ms * 1e6)
            yield make.recorded(late_ns, settings.detector.topic, stamp_ns, boxes)
        if self._stage.scenario.recording.truth_rate_hz:
            shown = visibility(image, camera, movers, measurement.begin_ns)
            truths = _visible_objects(shown, movers), _whole_objects(shown, movers)
            for topic, objects in zip(camera_truth_topics(name), truths, strict=True):
                truth = make.detections_2d(stamp_ns, model.frame_id, objects)
                yield make.recorded(log_ns, topic, stamp_ns, truth)


def _due(sensor: _Sensor, until_ns: int, start_limit_ns: int) -> Iterator[Measurement]:
    """The next measurements of a sensor that end by `until_ns` and begin before `start_limit_ns`."""
    while (
        sensor.next.end_ns <= until_ns
        and sensor.next.begin_ns < start_limit_ns
        and sensor.timing.is_alive(sensor.next.begin_ns)
    ):
        yield sensor.next
        sensor.next = _measurement(sensor.timing, sensor.device, sensor.next.number + 1)


def _measurement(timing: Timing, device: Lidar | Camera, number: int) -> Measurement:
    if isinstance(device, Lidar):
        return timing.measurement(number, begin_ns=device.begin_ns(number), end_ns=device.begin_ns(number + 1))
    return timing.measurement(number, lasts_ns=device.after_ns)


def _cloud_fields(sweep: Sweep) -> dict[str, Array]:
    """The fields of the ROS velodyne driver (x y z intensity ring time), and the return type in dual mode."""
    x, y, z = sweep.xyz.T
    fields: dict[str, Array] = {"x": x, "y": y, "z": z, "intensity": sweep.intensity, "ring": sweep.ring}
    fields["time"] = (sweep.time_offset_ns * 1e-9).astype(np.float32)
    return fields if sweep.return_type is None else fields | {"return_type": sweep.return_type}


def _detected_objects(found: Detected, movers: Sequence[Mover]) -> list[ViewedObject]:
    """Boxes of the simulated detector in an image of a scene with these movers."""
    return [
        ViewedObject("" if row == NO_MOVER else movers[row].name, row, xyxy.tolist(), (class_of(class_name, score),))
        for xyxy, score, class_name, row in zip(
            found.xyxy, found.scores.tolist(), found.class_names, found.movers.tolist(), strict=True
        )
    ]


def _visible_objects(shown: Visibility, movers: Sequence[Mover]) -> list[ViewedObject]:
    hidden, outside = shown.occlusion.tolist(), shown.truncation.tolist()
    return [
        _viewed(row, shown, shown.visible_xyxy, movers, occlusion=hidden[row], truncation=outside[row])
        for row in np.flatnonzero(shown.visible_px).tolist()
    ]


def _whole_objects(shown: Visibility, movers: Sequence[Mover]) -> list[ViewedObject]:
    """The movers that an image would show if nothing hid them."""
    rows = np.flatnonzero(np.isfinite(shown.truncation)).tolist()
    return [_viewed(row, shown, shown.whole_xyxy, movers) for row in rows]


def _viewed(row: int, shown: Visibility, boxes: F64, movers: Sequence[Mover], **shares: float) -> ViewedObject:
    mover, pixels = movers[row], counted(IMAGE_PIXELS, int(shown.visible_px[row]))
    hypotheses = (class_of(mover.class_name), pixels, *(counted(name, share) for name, share in shares.items()))
    return ViewedObject(mover.name, row, boxes[row].tolist(), hypotheses)
