"""Sweeps of drawn worlds for training: points and true boxes, without files, cameras and motion within a sweep.

A sweep is a snapshot: everything stands still while it is taken, and one ray is cast for each beam. What a recording
has beyond that is left out: points between two surfaces at edges, second echoes, textures. Several sweeps, each by
another lidar in another place, share one world, because building a world takes longer than casting its beams.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from lidcam.bags.simulator.recorder.stage import build_mover
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import LidarScenario
from lidcam.bags.simulator.sensors.beams import pattern_of
from lidcam.bags.simulator.sensors.echoes import intensity, returned_share
from lidcam.bags.simulator.vehicles.footprints import footprint, overlap
from lidcam.bags.simulator.vehicles.routes import Route
from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, shape_of
from lidcam.bags.simulator.world.mesh import Material, Mesh, merged
from lidcam.bags.simulator.world.motion import RaisedPath, State, Trajectory, placed_vertices
from lidcam.bags.simulator.world.open3d_runtime import load_open3d
from lidcam.bags.simulator.world.places.places import height_of, mesh_of
from lidcam.bags.simulator.world.scene import dotted, mapped, packed
from lidcam.bags.simulator.worlds.draw import Family, random_lidar, random_numbers_of, random_scenario
from lidcam.bags.simulator.worlds.errors import erring_lidar
from lidcam.bags.simulator.worlds.site import first_state
from lidcam.pipeline.core.arrays import F32, F64, I32, I64
from lidcam.pipeline.core.geometry.rotations import pose_matrix

open3d = load_open3d()

SWEEPS_PER_WORLD = 16  # seeds `k * SWEEPS_PER_WORLD` and the following are of one world
SPECKLE, BEHIND_M = 0.06, 1e-3  # see `lidcam.bags.simulator.sensors.lidar`
FIRST_NS = np.zeros(1, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class TrainingSweep:
    """One sweep, in the frame in which lidcam works: of a car's `base_link` (`road`), else of the site."""

    points: F32  # (N, 4) float32 x, y, z in metres, and intensity from 0 to 255
    centers: F64  # (M, 3) centre of the box of each road user, metres; those that no point is on, too
    sizes: F64  # (M, 3) length, width, height, metres; see the ground truth of recordings for what they hold
    yaws: F64  # (M,) headings, radians about +z
    class_names: tuple[str, ...]  # of each: car, van, truck, bus, cyclist or pedestrian
    point_counts: I32  # (M,) points on each
    origin: F64  # (3,) where the lidar is as recorded, metres
    lidar: LidarScenario  # its settings, and its mounting error, which points and origin have


def sweep(family: Family, seed: int, *, exact: bool = False) -> TrainingSweep:
    """The sweep of a seed; always the same, to be asked for in rising order because worlds are kept for a while.

    An `exact` one is the same without mounting error.
    """
    world_seed, number = divmod(seed, SWEEPS_PER_WORLD)
    return _world(family, world_seed).sweep(family, world_seed, number, exact=exact)


@lru_cache(2)
def _world(family: Family, seed: int) -> "_World":
    return _World(random_scenario(family, seed))


class _World:
    """The world of a scenario when its recording begins, in the ray caster."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self._height = scenario, height_of(scenario)
        self._routes = {name: Route.from_scenario(route) for name, route in scenario.routes.items()}
        self._caster: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
        self._rows: dict[Material, int] = {}
        self._materials: list[I64] = []
        self._add(mesh_of(scenario))
        users = {name: vehicle for name, vehicle in scenario.vehicles.items() if not vehicle.ego}
        boxes, self._grounds = [], []
        for name, vehicle in users.items():
            state = first_state(vehicle, self._routes)
            path = self._stood(state)
            mover = build_mover(name, vehicle, path)
            self._add(merged(*(replace(part.mesh, vertices=placed_vertices(part, 0)) for part in mover.parts)))
            body = mover.body_at(0)
            center = path.poses(FIRST_NS).apply(np.array([body.center_m]))[0]
            boxes.append((*center.tolist(), *body.size_m, state.yaw_rad))
            self._grounds.append(footprint(shape_of(vehicle.shape, vehicle.scale), state))
        self._boxes = np.array(boxes, np.float64).reshape(-1, 7)
        self._class_names = tuple(SHAPES[vehicle.shape].class_name for vehicle in users.values())
        self._material = np.concatenate(self._materials)
        self._starts = np.cumsum([0, *map(len, self._materials)])
        looks = [(look.reflectivity, look.mirror, look.transmission) for look in self._rows]
        self._looks = np.array(looks, np.float64).reshape(-1, 3)

    def sweep(self, family: Family, seed: int, number: int, *, exact: bool) -> TrainingSweep:
        """The sweep of the scenario's lidar, or from number 1 on of another one."""
        draw, scenario = random_numbers_of(family, seed, 1 + number), self._scenario
        lidar = scenario.lidars["top"] if number == 0 else random_lidar(family, draw, scenario.ground, scenario.things)
        lidar = lidar if exact else erring_lidar(lidar, "top", seed, number)
        base = self._ego_pose(draw, elsewhere=number > 0) if lidar.mounted_on else np.eye(4)
        T_site_lidar = base @ lidar.T_carrier_body("base").matrix
        beams = pattern_of(lidar).beams(0).directions.reshape(-1, 3).astype(np.float32)
        directions = mapped(beams, T_site_lidar[:3, :3])
        met, range_m, body, share = self._surfaces(T_site_lidar[:3, 3], directions, draw)
        share *= np.exp(-SPECKLE * np.abs(draw.standard_normal(len(met))))
        kept = (range_m >= lidar.min_range_m) & (range_m <= lidar.max_range_m * np.sqrt(share))
        kept &= draw.random(len(met)) >= lidar.dropout
        some = np.flatnonzero(kept)
        range_m = range_m.take(some) + draw.normal(0, lidar.range_noise_m, len(some)).astype(np.float32)
        scaled = lidar.intensity_gain * intensity(share.take(some)) - lidar.intensity_floor
        T_out = lidar.T_carrier_recorded("base").matrix
        xyz = mapped(beams.take(met.take(some), 0), T_out[:3, :3]) * range_m[:, None] + T_out[:3, 3].astype(np.float32)
        points = np.c_[xyz, np.clip(np.rint(scaled), 0, 255).astype(np.float32)]
        # Body 0 is the world, which stands still.
        counts = np.bincount(body.take(some), minlength=1 + len(self._boxes))[1:].astype(np.int32)
        back = np.linalg.inv(base)
        centers = self._boxes[:, :3] @ back[:3, :3].T + back[:3, 3]
        yaws = self._boxes[:, 6] + np.arctan2(back[1, 0], back[0, 0])
        yaws = np.arctan2(np.sin(yaws), np.cos(yaws))
        return TrainingSweep(
            points, centers, self._boxes[:, 3:6].copy(), yaws, self._class_names, counts, T_out[:3, 3].copy(), lidar
        )

    def _surfaces(self, origin: F64, directions: F32, draw: np.random.Generator) -> tuple[I64, F32, I64, F64]:
        """Where rays (N, 3) from a point end: rows (K,) that hit something, distance, body, and share of light.

        Those that hit glass mostly pass, and end at what is behind it.
        """
        row, range_m, body, material, cos = self._cast(packed(origin, directions))
        passed = self._looks[:, 2].take(material)
        glass = np.flatnonzero((passed > 0) & (draw.random(len(row)) >= self._looks[:, 1].take(material)))
        ahead = directions.take(row.take(glass), 0)
        onward = origin.astype(np.float32) + ahead * (range_m.take(glass) + BEHIND_M)[:, None]
        behind = self._cast(packed(onward, ahead))
        range_m[glass], material[glass] = np.inf, 0
        at = glass.take(behind[0])
        range_m[at] = np.linalg.norm(onward.take(behind[0], 0) - origin, axis=1) + behind[1]
        body[at], material[at], cos[at] = behind[2:]
        reflectivity, mirror, _ = self._looks.take(material, 0).T
        share = returned_share(reflectivity, mirror, cos)
        share[at] *= passed.take(at) ** 2
        return row, range_m, body, share

    def _cast(self, rays: F32) -> tuple[I64, F32, I64, I64, F64]:
        """Rows (K,) of the rays that hit something, distance, body, row of the material, cosine of the incidence."""
        answer = self._caster.cast_rays(open3d.core.Tensor.from_numpy(rays), nthreads=1)
        distance = answer["t_hit"].numpy()
        met = np.flatnonzero(np.isfinite(distance))
        body = answer["geometry_ids"].numpy().take(met).astype(np.int64)
        triangle = answer["primitive_ids"].numpy().take(met).astype(np.int64)
        material = self._material.take(self._starts.take(body) + triangle)
        cos = np.abs(dotted(answer["primitive_normals"].numpy().take(met, 0), rays.take(met, 0)[:, 3:]))
        return met, distance.take(met), body, material, cos.astype(np.float64)

    def _add(self, mesh: Mesh) -> None:
        self._caster.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
        rows = [self._rows.setdefault(look, len(self._rows)) for look in mesh.palette]
        self._materials.append(np.array(rows, np.int64)[mesh.materials])

    def _ego_pose(self, draw: np.random.Generator, *, elsewhere: bool) -> F64:
        """Pose (4, 4) of the carrier's base frame: as in the scenario, or where its lanes are free."""
        ego = self._scenario.vehicles[self._scenario.ego]
        for _ in range(20 if elsewhere else 0):
            route = ("east", "west")[int(draw.integers(2))]
            start_m = float(draw.uniform(15, self._routes[route].length_m - 15))
            there = ego.model_copy(update={"route": route, "route_start_m": start_m})
            ground = footprint(SHAPES[ego.shape], first_state(there, self._routes))
            if not any(overlap(ground, other) for other in self._grounds):
                ego = there
                break
        pose = self._stood(first_state(ego, self._routes)).poses(FIRST_NS)
        return pose_matrix(pose.rotation[0], pose.translation[0])

    def _stood(self, state: State) -> RaisedPath:
        """The path of a road user on the ground."""
        return RaisedPath(Trajectory(0, state), self._height)
