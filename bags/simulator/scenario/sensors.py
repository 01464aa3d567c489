"""Lidars and cameras of a scenario, and their faults."""

from typing import Annotated, Literal

from pydantic import Field
from scipy.spatial.transform import Rotation

from bags.simulator.scenario.model import Metres, Topic, Vector
from pipeline.core.geometry.transform import Transform
from pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel, Share

__all__ = ["COEFFICIENTS", "CameraScenario", "Detector2DScenario", "LidarScenario", "Miscalibration", "SensorScenario"]

COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""Of the distortion models, as CameraInfo has them."""


class Miscalibration(SettingsModel):
    """By how much the recorded extrinsics of a sensor are wrong.

    Attributes:
        rpy_deg: Roll, pitch, yaw in the frame of the sensor's body (x forward, y left, z up).
        xyz_cm: Shift in that frame.
    """

    rpy_deg: Vector = (0.0, 0.0, 0.0)
    xyz_cm: Vector = (0.0, 0.0, 0.0)


class SensorScenario(SettingsModel):
    """What every sensor has: a place, a clock, and faults.

    Attributes:
        topic: Of its measurements.
        frame_id: In its messages and in tf.
        mounted_on: Name of a vehicle; empty: fixed to the site.
        position_m: Its place.
        rpy_deg: Roll, pitch, yaw (about fixed x, y, z) of its body: x forward, y left, z up. A camera looks along x.
        rate_hz: Measurements per second.
        phase_ms: The first measurement begins this long after the scenario.
        jitter_ms: Standard deviation of the moment of measurement.
        clock_offset_ms: Its clock runs ahead of the true time by this: stamps are wrong by it.
        drop_rate: Share of its messages that are lost.
        log_delay_ms: A message is recorded this long after its measurement ended; an image, after its stamp.
        log_jitter_ms: Standard deviation of that delay (never negative); large ones let messages overtake each other.
        dies_at_s: No measurement begins at or after this time of the scenario.
        miscalibration: What is wrong with its recorded extrinsics.
    """

    topic: Topic
    frame_id: str
    mounted_on: str = ""
    position_m: tuple[Metres, Metres, Metres]
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    rate_hz: Positive = 10.0
    phase_ms: NotNegative = 0.0
    jitter_ms: NotNegative = 0.0
    clock_offset_ms: float = 0.0
    drop_rate: Share = 0.0
    log_delay_ms: NotNegative = 5.0
    log_jitter_ms: NotNegative = 0.0
    dies_at_s: NotNegative | None = None
    miscalibration: Miscalibration = Miscalibration()

    def T_carrier_body(self, carrier_frame: str) -> Transform:
        """The true place of the sensor's body (x forward) on what carries it."""
        turn = Rotation.from_euler("xyz", self.rpy_deg, degrees=True)
        return Transform.from_quaternion(carrier_frame, self.frame_id, self.position_m, turn.as_quat())


class LidarScenario(SensorScenario):
    """A lidar that turns.

    Attributes:
        model: A Velodyne model of `readers.velodyne.models`, or `linear`: evenly spread beams.
        beams: Number of beams of a `linear` lidar.
        elevation_deg: Lowest and highest beam of a `linear` lidar.
        columns: Firings per turn of a `linear` lidar; the other models fire at their own pace.
        firing_stride: Only every n-th firing is recorded, for small files (points only).
        start_azimuth_deg: Where a sweep begins, clockwise from the front.
        output: `points` (PointCloud2 on `topic`), `packets` (velodyne_msgs/VelodyneScan on `packets_topic`) or `both`.
        packets_topic: Topic of the packets.
        return_mode: Which echoes are recorded where a beam meets an edge.
        divergence_mrad: Full angle of a beam.
        echo_separation_m: Two surfaces in one beam make two echoes if they are further apart than this.
        min_range_m: Nothing nearer is measured.
        max_range_m: A white surface is seen this far; darker ones less far.
        range_noise_m: Standard deviation.
        dropout: Share of the echoes that are lost for no reason.
    """

    model: Literal["VLP-16", "Puck Hi-Res", "HDL-32E", "VLP-32A", "VLP-32B", "VLP-32C", "linear"] = "VLP-16"
    beams: Count = 64
    elevation_deg: tuple[float, float] = (-25.0, 3.0)
    columns: Count = 1800
    firing_stride: Count = 1
    start_azimuth_deg: float = 180.0
    output: Literal["points", "packets", "both"] = "points"
    packets_topic: Topic | Literal[""] = ""
    return_mode: Literal["strongest", "last", "dual"] = "strongest"
    divergence_mrad: NotNegative = 3.0
    echo_separation_m: Positive = 0.5
    min_range_m: NotNegative = 0.1
    max_range_m: Positive = 100.0
    range_noise_m: NotNegative = 0.01
    dropout: Share = 0.005

    @property
    def topics(self) -> list[str]:
        """Where its messages are."""
        both = {"points": [self.topic], "packets": [self.packets_topic], "both": [self.topic, self.packets_topic]}
        return both[self.output]


class Detector2DScenario(SettingsModel):
    """A 2D detector that errs, instead of a network.

    Attributes:
        topic: Of its vision_msgs/Detection2DArray.
        delay_ms: Recorded this long after the image.
        pixel_noise_px: Standard deviation of each edge.
        miss_rate: Share of the visible things that it misses.
        false_per_image: False boxes per image on average.
        min_visible: A thing of which less than this share is visible is not found.
        min_height_px: Neither is one whose box is lower than this.
    """

    topic: Topic
    delay_ms: NotNegative = 30.0
    pixel_noise_px: NotNegative = 1.2
    miss_rate: Share = 0.05
    false_per_image: NotNegative = 0.05
    min_visible: Share = 0.3
    min_height_px: NotNegative = 12.0


class CameraScenario(SensorScenario):
    """A camera; the frame of its messages is the optical one (z forward, x right, y down).

    Attributes:
        info_topic: Of its sensor_msgs/CameraInfo.
        width_px: Columns.
        height_px: Rows.
        focal_px: fx and fy.
        center_px: cx and cy; empty: the middle of the image.
        distortion_model: As in CameraInfo.
        distortion: Coefficients in its order; what is left out is 0.
        exposure_ms: Light is gathered this long; the stamp is the middle.
        motion_blur: Whether what moves is blurred by the exposure.
        gain: Brightness.
        noise: Standard deviation of a pixel's value, of 255.
        output: `jpeg` (CompressedImage on `topic`/compressed) or `raw` (Image on `topic`, rgb8).
        jpeg_quality: 1 to 100.
        detector: A simulated detector that looks at it.
    """

    info_topic: Topic
    width_px: Count = 640
    height_px: Count = 480
    focal_px: tuple[Positive, Positive]
    center_px: tuple[float, float] | None = None
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"
    distortion: tuple[float, ...] = ()
    exposure_ms: NotNegative = 4.0
    motion_blur: bool = False
    gain: Positive = 1.0
    noise: NotNegative = 1.0
    output: Literal["jpeg", "raw"] = "jpeg"
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 80
    detector: Detector2DScenario | None = None

    @property
    def image_topic(self) -> str:
        """Where its images are."""
        return f"{self.topic}/compressed" if self.output == "jpeg" else self.topic

    @property
    def topics(self) -> list[str]:
        """Where its messages are."""
        return [self.image_topic, self.info_topic, *([self.detector.topic] if self.detector else [])]

    @property
    def coefficients(self) -> tuple[float, ...]:
        """All of the distortion model's."""
        return (*self.distortion, *[0.0] * (COEFFICIENTS[self.distortion_model] - len(self.distortion)))
