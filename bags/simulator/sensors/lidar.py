"""A spinning lidar in a scene: sweeps as its driver would publish them.

Each beam is cast at its own time and from the sensor's pose at that time. Where a beam may hit an edge or glass, its
rim and what lies behind the glass are cast, too. Points are in the sensor frame at the time of their own firing, as
from drivers without motion compensation.
"""

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from lidcam.bags.simulator.scenario.sensors import LidarScenario
from lidcam.bags.simulator.sensors.beams import Beams, EncodedPackets, VelodynePattern, pattern_of
from lidcam.bags.simulator.sensors.echoes import NO_ECHO, Echoes, Optics, Reflected, distinct_echoes, intensity
from lidcam.bags.simulator.sensors.timing import random_numbers
from lidcam.bags.simulator.world.motion import FixedPath, Path, Span, turned
from lidcam.bags.simulator.world.scene import Hits, Rays, Scene, dotted
from lidcam.pipeline.core.arrays import F32, F64, I64, U8, U16, Bools, join_rows

# Columns of `Echoes`, and return types as in `PointCloud.return_type`
STRONGEST, LAST = 0, 1
RETURN_STRONGEST, RETURN_LAST, RETURN_BOTH = 1, 2, 3
MAX_STEPS = 0xFFFF

SKY_M = 1e5  # range of a beam that hits nothing, in the search for edges
SPECKLE = 0.06  # scale of the loss of light, 1 - exp(-SPECKLE |n|) of normal n; diffuse surfaces stay below 100
RIM_WEIGHT = 1 / 6  # share of a beam's light in each of the four rays at its rim; the middle ray has the rest
MAX_PANES = 4  # glass surfaces that a beam passes
MIN_LIGHT = 0.05  # share below which a beam is not followed behind glass
BEHIND_M = 1e-4  # offset behind a glass surface where a beam continues
SIGN_OF_SIDE = (-1, 1, -1, 1)  # sign of each `Side` towards the right or up; the lidar spins clockwise


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One turn of a lidar."""

    begin_ns: int  # true time of its first firing since the start of the scenario
    xyz: F32  # (N, 3) metres in the sensor frame at the time of each point
    intensity: F32  # (N,) whole numbers from 0 to 255, on Velodyne's scale
    ring: U16  # (N,) from the lowest elevation up
    time_offset_ns: I64  # (N,) after `begin_ns`
    return_type: U8 | None  # (N,) 1 the strongest echo, 2 the last, 3 both; None with one echo per beam
    hits_per_mover: I64  # (M,) number of points on each mover of the scene
    hit_offsets_ns: I64  # (M,) sum of the time offsets of these points
    packets: EncodedPackets | None  # by a clock that started with the scenario; None without packet output

    def __len__(self) -> int:
        return len(self.xyz)


class Lidar:
    """One lidar of a scenario, whose name seeds its random numbers, too.

    `path` is that of its body (x forward, y left, z up) in the world. Clock offset, jitter, drops and failure are not
    applied here.
    """

    def __init__(self, name: str, scenario: LidarScenario, path: Path, scene: Scene, seed: int) -> None:
        self._name, self.scenario, self._path, self._scene, self._seed = name, scenario, path, scene, seed
        self._pattern = pattern_of(scenario)
        self._optics = Optics(scene.palette)
        self._by_elevation = np.argsort(self._pattern.elevation_rad, kind="stable")
        self._rings = np.empty(len(self._by_elevation), np.uint16)
        self._rings[self._by_elevation] = np.arange(len(self._by_elevation), dtype=np.uint16)
        self._dual = scenario.return_mode == "dual"

    def begin_ns(self, number: int) -> int:
        """True time of the first firing of a sweep, when the one before is complete: paths of movers must reach it."""
        return self._pattern.begin_ns(number)

    def sweep(self, number: int) -> Sweep:
        """One turn; independent of other calls."""
        beams = self._pattern.beams(number)
        range_m, share, mover = self._received(beams, number)
        steps = np.rint(range_m / self._pattern.range_step_m)
        steps[steps > MAX_STEPS] = NO_ECHO
        range_m = steps * self._pattern.range_step_m
        scaled = self.scenario.intensity_gain * intensity(share) - self.scenario.intensity_floor
        brightness = np.clip(np.rint(scaled), 0, 255)
        packets = None
        if self.scenario.output != "points" and isinstance(self._pattern, VelodynePattern):
            shape = (*beams.times_ns.shape, *([2] if self._dual else []))
            reflectivity = brightness.reshape(shape).astype(np.uint8)
            packets = self._pattern.encode(number, range_m.reshape(shape), reflectivity)
        return_type = None
        if self._dual:
            both = steps[:, 0] == steps[:, 1]
            steps[both, 0] = NO_ECHO
            return_type = np.stack([np.full(len(steps), RETURN_LAST), np.where(both, RETURN_BOTH, RETURN_STRONGEST)], 1)
        kept = np.flatnonzero(steps)
        beam, laser = kept // steps.shape[1], kept // steps.shape[1] % len(self._rings)
        directions = beams.measured_directions.reshape(-1, 3)
        xyz, kept_m = directions.take(beam, 0), range_m.reshape(-1).take(kept)
        for axis in range(3):
            xyz[:, axis] *= kept_m
        xyz += beams.origins.take(laser, 0)
        hit = mover.reshape(-1)[kept]
        time_offset_ns = beams.times_ns.reshape(-1)[beam] - self.begin_ns(number)
        on_mover, count = np.flatnonzero(hit >= 0), len(self._scene.movers)
        offsets_ns = np.zeros(count, np.int64)
        np.add.at(offsets_ns, hit.take(on_mover), time_offset_ns.take(on_mover))
        return Sweep(
            self.begin_ns(number),
            xyz.astype(np.float32),
            brightness.reshape(-1)[kept].astype(np.float32),
            self._rings[laser],
            time_offset_ns,
            None if return_type is None else return_type.reshape(-1)[kept].astype(np.uint8),
            np.bincount(hit.take(on_mover), minlength=count).astype(np.int64),
            offsets_ns,
            packets,
        )

    def _received(self, beams: Beams, number: int) -> tuple[F64, F64, I64]:
        """Noisy range (0 for no echo), share of light, mover: (N, 1), or (N, 2) for the last and the strongest echo."""
        count = beams.times_ns.size
        columns = {"strongest": [STRONGEST], "last": [LAST], "dual": [LAST, STRONGEST]}[self.scenario.return_mode]
        random = random_numbers(self._seed, self._name, "lidar", number)
        speckle = np.exp(-SPECKLE * np.abs(random.standard_normal(count, np.float32)))
        noise_m = self.scenario.range_noise_m * random.standard_normal((count, len(columns)), np.float32)
        lost = random.random((count, len(columns)), np.float32) < self.scenario.dropout

        echoes = self._echoes(beams, speckle.astype(np.float64))
        range_m, share, mover = echoes.range_m[:, columns], echoes.share[:, columns], echoes.mover[:, columns]
        if self._dual:  # a single echo is measured once
            one = range_m[:, 0] == range_m[:, 1]
            noise_m[one, 0], lost[one, 0] = noise_m[one, 1], lost[one, 1]
        return np.where((range_m > 0) & ~lost, np.maximum(range_m + noise_m, 0.0), NO_ECHO), share, mover

    def _echoes(self, beams: Beams, speckle: F64) -> Echoes:
        """The echoes of all beams without noise; `speckle` (N,) is a factor on the light of each beam."""
        rays, rotation = self._placed(beams)
        span = Span(rays.times_ns)
        hits = self._scene.cast(rays, span)
        cos_incidence = _cos_incidence(hits, rays)
        share = speckle * self._optics.share(hits, cos_incidence)
        found = (hits.distance_m <= self.scenario.max_range_m * np.sqrt(share)) & (share > 0)
        found &= hits.distance_m >= self.scenario.min_range_m
        range_m = np.where(found, hits.distance_m, NO_ECHO)
        echoes = Echoes(np.stack([range_m] * 2, 1), np.stack([share] * 2, 1), np.stack([hits.mover] * 2, 1))

        rim, rim_rays, rim_hits = self._rim(hits, rays, beams, rotation, span)
        glass = np.flatnonzero(self._optics.transmission.take(hits.material, mode="wrap"))
        mixed = np.unique(np.concatenate([glass, rim]))
        if not len(mixed):
            return echoes
        beam = np.concatenate([np.arange(len(mixed)), np.searchsorted(mixed, rim)])
        # Rim rays that hit the same surface count towards the middle.
        weight = np.full(len(beam), RIM_WEIGHT)
        weight[: len(mixed)] = 1 - RIM_WEIGHT * np.bincount(beam[len(mixed) :], minlength=len(mixed))
        rays, hits = join_rows(rays.select(mixed), rim_rays), join_rows(hits.select(mixed), rim_hits)
        some = distinct_echoes(
            self._light(beam, rays, hits, weight * speckle[mixed][beam], span),
            len(mixed),
            reach_m=self.scenario.max_range_m,
            nearest_m=self.scenario.min_range_m,
            apart_m=self.scenario.echo_separation_m,
            second_strongest=self._dual,
        )
        echoes.range_m[mixed], echoes.share[mixed], echoes.mover[mixed] = some.range_m, some.share, some.mover
        return echoes

    def _placed(self, beams: Beams) -> tuple[Rays, F64]:
        """Rays (F * L) from the sensor's pose in the middle of each firing, and its rotation (F or 1, 3, 3) there."""
        if isinstance(self._path, FixedPath):
            pose = self._path.poses(beams.times_ns[:1, 0])
            turned_beams = cv2.transform(beams.directions.reshape(-1, 1, 3), pose.rotation[0])
            directions = np.asarray(turned_beams, np.float64).reshape(-1, 3)
            origins = np.tile(pose.apply(beams.origins), (len(beams.times_ns), 1))
            return Rays(origins, directions, beams.times_ns.reshape(-1)), pose.rotation
        poses = self._path.poses((beams.times_ns[:, 0] + beams.times_ns[:, -1]) // 2)
        origins, directions = np.empty_like(beams.directions), np.empty_like(beams.directions)
        for axis in range(3):
            x, y, z = poses.rotation[:, axis].T[:, :, None]
            for source, target in ((beams.origins, origins), (beams.directions, directions)):
                target[:, :, axis] = x * source[..., 0] + y * source[..., 1] + z * source[..., 2]
        origins += poses.translation[:, None]
        rays = Rays(origins.reshape(-1, 3), directions.reshape(-1, 3), beams.times_ns.reshape(-1))
        return rays, poses.rotation

    def _rim(self, hits: Hits, rays: Rays, beams: Beams, rotation: F64, span: Span) -> tuple[I64, Rays, Hits]:
        """Beams (K,), rays and hits of rim rays that hit another surface than the middle of their beam.

        Only sides with an edge before the next beam are cast.
        """
        half_angle_rad = self.scenario.divergence_mrad * 1e-3 / 2
        if not half_angle_rad:
            none = np.empty(0, np.int64)
            return none, rays.select(none), hits.select(none)
        grid = beams.directions.shape
        edges = edge_beams(
            hits.distance_m.reshape(grid[:2]),
            hits.normal.reshape(grid),
            rays.origins.reshape(grid),
            rays.directions.reshape(grid),
            step_m=self.scenario.echo_separation_m,
            reach_m=self.scenario.max_range_m * self._optics.max_reflectivity**0.5,
            by_elevation=self._by_elevation,
        )
        beam, side = np.nonzero(edges.reshape(-1, 4))
        x, y, z = beams.directions.reshape(-1, 3).take(beam, 0).T
        across = np.maximum(np.hypot(x, y), 1e-9)
        right = np.stack([y / across, -x / across, np.zeros(len(beam))], 1)
        above = np.stack([-x * z / across, -y * z / across, across], 1)
        away = np.where((side >= Side.BELOW)[:, None], above, right) * np.array(SIGN_OF_SIDE)[side, None]
        middle = rays.select(beam)
        rotation = rotation if len(rotation) == 1 else rotation.take(beam // grid[1], 0)
        spread = middle.directions + half_angle_rad * turned(rotation, away)
        rim = Rays(middle.origins, spread / np.sqrt(1 + half_angle_rad**2), middle.times_ns)
        seen = self._scene.cast(rim, span)
        steps_m = np.minimum(seen.distance_m, SKY_M) - np.minimum(hits.distance_m.take(beam), SKY_M)
        others = np.flatnonzero(np.abs(steps_m) > self.scenario.echo_separation_m)
        return beam[others], rim.select(others), seen.select(others)

    def _light(self, beam: I64, rays: Rays, hits: Hits, weight: F64, span: Span) -> Reflected:
        """Light from the first surface of each ray (K), and from those behind it if it is glass."""
        passed_m = np.zeros(len(rays))
        layers = []
        for _ in range(MAX_PANES + 1):
            layers.append((beam, passed_m + hits.distance_m, weight, hits, _cos_incidence(hits, rays)))
            left = weight * self._optics.transmission[hits.material] ** 2  # through the glass and back
            on = np.flatnonzero(left > MIN_LIGHT)
            if not len(on):
                break
            onward_m = hits.distance_m[on] + BEHIND_M
            directions = rays.directions[on]
            rays = Rays(rays.origins[on] + directions * onward_m[:, None], directions, rays.times_ns[on])
            hits = self._scene.cast(rays, span)
            beam, passed_m, weight = beam[on], passed_m[on] + onward_m, left[on]
        beams, ranges_m, weights, seen, cosines = zip(*layers, strict=True)
        together = join_rows(*seen)
        share = np.concatenate(weights) * self._optics.share(together, np.concatenate(cosines))
        return Reflected(np.concatenate(beams), np.concatenate(ranges_m), share, together.mover)


def _cos_incidence(hits: Hits, rays: Rays) -> F64:
    return -dotted(hits.normal, rays.directions)


class Side(IntEnum):
    """The neighbour of a beam: in the firing before or after, or the laser below or above."""

    BEFORE, AFTER, BELOW, ABOVE = range(4)


def edge_beams(
    distance_m: F64, normal: F64, origins: F64, directions: F64, *, step_m: float, reach_m: float, by_elevation: I64
) -> Bools:
    """Whether a beam has an edge on a side, of its own surface or of its neighbour's: (F, L, 4) by `Side`.

    The nearer of two surfaces ends between two beams if its plane would still be in front at the other beam: a floor
    seen at a grazing angle or the foot of a wall is no edge. Jumps in range smaller than `step_m` or beyond `reach_m`
    are ignored. Distances are (F, L) by firing and laser, infinite for a miss; normals, origins and directions (F, L,
    3) as of `Rays` and `Hits`; `by_elevation` (L,) has the lasers from the lowest to the highest.
    """
    firings, lasers = distance_m.shape
    range_m = np.minimum(distance_m, SKY_M)
    flat_m, normals = range_m.reshape(-1), normal.reshape(-1, 3)
    starts, ahead = origins.reshape(-1, 3), directions.reshape(-1, 3)

    def ends(one: I64, other: I64) -> Bools:
        swapped = flat_m.take(one) > flat_m.take(other)
        near, far = np.where(swapped, other, one), np.where(swapped, one, other)
        face, near_m = normals.take(near, 0), flat_m.take(near)
        depth_m = dotted(face, starts.take(near, 0) - starts.take(far, 0))
        depth_m += near_m * dotted(face, ahead.take(near, 0))
        along = dotted(face, ahead.take(far, 0))
        # A plane that the other beam never hits counts as infinitely far.
        goes_on_m = depth_m / np.where(along < 0, along, -1e-12)
        return np.asarray((goes_on_m < flat_m.take(far) - step_m) & (near_m < reach_m))

    stacked = range_m[:, by_elevation]
    firing, place = np.nonzero(np.abs(stacked[:, 1:] - stacked[:, :-1]) > step_m)
    beside = np.flatnonzero(np.abs(range_m[1:] - range_m[:-1]) > step_m)
    pairs = (
        (beside, beside + lasers, Side.BEFORE, Side.AFTER),
        (firing * lasers + by_elevation[place], firing * lasers + by_elevation[place + 1], Side.BELOW, Side.ABOVE),
    )
    edges = np.zeros((firings * lasers, 4), np.bool_)
    for one, other, back, on in pairs:
        differ = ends(one, other)
        edges[one[differ], on] = edges[other[differ], back] = True
    return edges.reshape(firings, lasers, 4)
