"""A simulated camera: images of a scene, and the mover that each pixel shows.

A camera fixed to the site renders the static world once, and then only the windows with movers and their shadows; a
camera on a vehicle renders both for each image.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from lidcam.bags.simulator.scenario.scenario import SunScenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario
from lidcam.bags.simulator.sensors.lens import Lens, camera_model
from lidcam.bags.simulator.sensors.light import Light
from lidcam.bags.simulator.sensors.moving import put_movers
from lidcam.bags.simulator.sensors.still import Still, take_still
from lidcam.bags.simulator.sensors.timing import random_numbers
from lidcam.bags.simulator.world.motion import T_BODY_OPTICAL, FixedPath, MountedPath, Path, Poses
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F32, F64, I16, I64, U8
from lidcam.pipeline.core.camera import CameraModel

MOMENTS = 9  # averaged for a blurred image; an odd number, as the truth is that of the middle
FRACTION = 64  # images are kept in this fraction of a pixel value until noise is added
MAX_LIGHT = 4.0  # beyond, light is clipped
SHOULDER = 0.55  # beyond, the tone curve compresses highlights instead of clipping them
VIGNETTE = 0.10  # share of the light that the corners lose
NOISE_ROOM_PX = 96  # by which the noise field is larger than the image; each image uses a random crop
MAX_NOISE = 16_000  # in 1 / FRACTION of a pixel value: added to white, it stays within 16 bits
ROWS_AT_ONCE = 64  # rows read out together, which fit into the processor's caches
SHARED_NOISE = 0.8  # red, green and blue noise are correlated, as after demosaicing; 0.8^2 + 0.6^2 = 1


@dataclass(frozen=True, slots=True, eq=False)
class CameraImage:
    """One image and its ground truth."""

    rgb: U8  # (H, W, 3) sRGB
    movers: I16  # (H, W) row of the mover in the middle of each pixel and of the exposure; -1 for the static world
    alone_px: I64  # (M,) number of pixels of each mover without occlusion
    alone_xyxy: F64  # (M, 4) left, top, right, bottom of these pixels; NaN for none

    @property
    def seen_px(self) -> I64:
        """(M,) number of pixels that show each mover."""
        rows = self.movers[self.movers >= 0].astype(np.int64)
        return np.bincount(rows, minlength=len(self.alone_px)).astype(np.int64)


class Camera:
    """One camera of a scenario, whose name seeds its random numbers, too; x of its body is along the view, z up."""

    def __init__(
        self, name: str, scenario: CameraScenario, body: Path, scene: Scene, sun: SunScenario, seed: int
    ) -> None:
        self.name, self.scenario = name, scenario
        self.model: CameraModel = camera_model(scenario)
        self._path, self._fixed = MountedPath(body, T_BODY_OPTICAL), isinstance(body, FixedPath)
        self._scene, self._lens, self._light = scene, Lens(self.model), Light(sun, scene.palette)
        self._film = Film(scenario, name, seed, self._light.exposure)
        self._kept: tuple[Still, I16] | None = None

    def optical_pose(self, time_ns: int) -> Poses:
        """Pose (a single one) of the optical frame (z forward, x right, y down) in the world."""
        return self._path.poses(np.array([time_ns], np.int64))

    @property
    def after_ns(self) -> int:
        """Time from the middle of an exposure to its end; movers must be known until then."""
        return round(self.scenario.exposure_ms * 5e5) if self.scenario.motion_blur else 0

    def image(self, number: int, time_ns: int) -> CameraImage:
        """Image `number`, with the middle of its exposure at a time; independent of earlier images."""
        moments = self._moments(time_ns)
        stills = [self._static(moment) for moment in moments]
        seen = [
            put_movers(self._scene, self._light, self._lens, still, moment)
            for (still, _), moment in zip(stills, moments, strict=True)
        ]
        truth, developed = seen[len(seen) // 2], stills[0][1].copy()
        if len(seen) == 1:
            developed.reshape(-1, 3)[truth.pixels] = self._film.developed_pixels(truth.linear, truth.pixels)
        else:
            light = np.zeros_like(stills[0][0].linear)
            for (still, _), moving in zip(stills, seen, strict=True):
                linear = still.linear.copy()
                linear[moving.pixels] = moving.linear
                light += linear / np.float32(len(seen))
            developed = self._film.developed(light.reshape(developed.shape))
        owner = truth.owner.reshape(self.model.height_px, self.model.width_px)
        return CameraImage(self._film.read_out(developed, number), owner, truth.alone_px, truth.alone_xyxy)

    def _static(self, time_ns: int) -> tuple[Still, I16]:
        """The static world as light, and developed; a fixed camera renders it once."""
        if self._kept is None or not self._fixed:
            still = take_still(self._scene, self._light, self._lens, self.optical_pose(time_ns))
            shape = (self.model.height_px, self.model.width_px, 3)
            self._kept = still, self._film.developed(still.linear.reshape(shape))
        return self._kept

    def _moments(self, time_ns: int) -> list[int]:
        """Evenly spread times of the exposure around its middle; only the middle without blur."""
        exposure_ns = self.scenario.exposure_ms * 1e6
        if not self.scenario.motion_blur or not exposure_ns:
            return [time_ns]
        steps = (np.arange(MOMENTS) - (MOMENTS - 1) / 2) / MOMENTS
        return [max(time_ns + round(step * exposure_ns), 0) for step in steps]


class Film:
    """The image sensor of a camera: exposure, vignette, tone, sRGB and noise."""

    def __init__(self, scenario: CameraScenario, name: str, seed: int, exposure: float) -> None:
        self._name, self._seed, self._noise = name, seed, scenario.noise
        self._height, self._width = height, width = scenario.height_px, scenario.width_px
        x = (np.arange(width) - (width - 1) / 2) / max(np.hypot(width, height) / 2, 1)
        y = (np.arange(height) - (height - 1) / 2) / max(np.hypot(width, height) / 2, 1)
        exposure *= scenario.gain
        loss = 1 - VIGNETTE * (x**2 + y[:, None] ** 2)
        self._scale = np.asarray(exposure * loss * (65535 / MAX_LIGHT), np.float32)[..., None]

    @cached_property
    def _field(self) -> I16:
        """The noise field."""
        shape = (self._height + NOISE_ROOM_PX, self._width + NOISE_ROOM_PX, 3)
        random = random_numbers(self._seed, self._name, "noise field", 0)
        field = 0.6 * random.standard_normal(shape, np.float32)
        shared = SHARED_NOISE * random.standard_normal(shape[:2], np.float32)
        field += shared[..., None]
        field *= np.float32(self._noise * FRACTION)
        return np.clip(np.round(field, out=field), -MAX_NOISE, MAX_NOISE, out=field).astype(np.int16)

    def developed(self, linear: F32) -> I16:
        """Pixel values times `FRACTION` of an image (H, W, 3) of linear light."""
        return _encoded(linear * self._scale)

    def developed_pixels(self, linear: F32, pixels: I64) -> I16:
        """`developed` for some pixels (K, 3), numbered row by row."""
        return _encoded(linear * self._scale.reshape(-1).take(pixels)[:, None])

    def read_out(self, developed: I16, number: int) -> U8:
        """The final pixels (H, W, 3) of image `number`, with noise."""
        height, width, _ = developed.shape
        random = random_numbers(self._seed, self._name, "noise", number)
        top, left = random.integers(0, NOISE_ROOM_PX, 2)
        add_or_subtract = np.add if random.random() < 0.5 else np.subtract
        image = np.empty(developed.shape, np.uint8)
        for first in range(0, height, ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            values = developed[rows] + np.int16(FRACTION // 2)
            if self._noise:
                field = self._field[top : top + height, left : left + width]
                add_or_subtract(values, field[rows], out=values)
            values >>= 6  # FRACTION
            image[rows] = np.clip(values, 0, 255, out=values)
        return image


def _encoded(scaled: F32) -> I16:
    return np.take(_values(), np.clip(scaled, 0, 65535, out=scaled).astype(np.uint16))


@cache
def _values() -> I16:
    """Pixel values (sRGB, IEC 61966-2-1) times `FRACTION` of light from 0 to `MAX_LIGHT`, in 65536 steps."""
    linear: F64 = np.linspace(0.0, MAX_LIGHT, 65536)
    over, room = np.maximum(linear - SHOULDER, 0.0), 1 - SHOULDER
    toned = np.where(linear <= SHOULDER, linear, SHOULDER + room * (1 - np.exp(-over / room)))
    light = np.clip(toned, 0.0, 1.0)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * FRACTION * srgb).astype(np.int16)
