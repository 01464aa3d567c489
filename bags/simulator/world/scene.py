"""Rays against a world whose things move while the rays are cast.

What stands still is one body of Open3D's ray caster (Embree), every moving part one of its own, in its own frame. A ray
is taken into the frame of a part at the moment of that ray, so that a lidar that turns while things move sees them as
skewed as in reality and not in steps. Rays that pass a thing's bounding sphere by are not cast at it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bags.simulator.world.meshes.mesh import Material, Mesh
from bags.simulator.world.motion import Path, Poses, turned
from bags.simulator.world.open3d_runtime import load_libusb
from bags.simulator.world.placed import FEW_RAYS, Floats, PlacedPart, dotted, packed, threads_for
from pipeline.core.arrays import F32, F64, I64, Bools, check_array

load_libusb()
import open3d as _open3d  # noqa: E402  (needs libusb first)

open3d: Any = _open3d  # its stubs know no arrays

__all__ = ["STATIC", "Hits", "Mover", "Part", "Rays", "Scene", "Seen", "Span", "with_nearer"]

Columns = tuple[F64, F64, I64, I64, F64]

STATIC = -1
"""Row of what stands still, among the movers."""
NO_MATERIAL = -1
BOX_MARGIN = 1.2
"""All parts of a mover lie in the sphere around its box, blown up by this: limbs may reach out of it."""

EVEN_NS = 2_000_000
"""Things are taken to move and turn evenly for as long: at 10 rad/s that is right to 0.05 mm at an arm of a metre."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A rigid part of something that moves.

    Attributes:
        mesh: In the part's own frame.
        path: Of that frame.
    """

    mesh: Mesh
    path: Path


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """Something that moves, with the box that is the truth about it.

    Attributes:
        name: Unique in the scenario.
        class_name: Class in the truth (`car`, `truck`, `bus`, `cyclist`, `pedestrian`...).
        path: Of its base frame: on the ground, x forward.
        box_center_m: Centre of its box in the base frame.
        size_m: Length, width, height of the box; no part reaches out of it by more than a centimetre.
        parts: What it is made of.
    """

    name: str
    class_name: str
    path: Path
    box_center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    parts: tuple[Part, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Rays in the world frame.

    Attributes:
        origins: (N, 3) float64 metres.
        directions: (N, 3) float64 unit vectors.
        times_ns: (N,) int64 since the scenario began.
    """

    origins: F64
    directions: F64
    times_ns: I64

    def __post_init__(self) -> None:
        n = len(self.times_ns)
        check_array("origins", self.origins, (n, 3), np.float64)
        check_array("directions", self.directions, (n, 3), np.float64)
        check_array("times_ns", self.times_ns, (n,), np.int64)

    def __len__(self) -> int:
        return len(self.times_ns)

    def select(self, rows: Bools | I64) -> "Rays":
        """Some of them."""
        rows = _numbers(rows)
        return Rays(self.origins.take(rows, 0), self.directions.take(rows, 0), self.times_ns.take(rows))

    @staticmethod
    def together(parts: Sequence["Rays"]) -> "Rays":
        """All of them, one after the other."""
        origins, directions = (np.concatenate([getattr(part, name) for part in parts]) for name in Rays.__slots__[:2])
        return Rays(origins, directions, np.concatenate([part.times_ns for part in parts]))


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """The first surface along each of N rays.

    Attributes:
        distance_m: (N,) float64; infinite for a miss.
        normal: (N, 3) float64 unit vectors in the world frame, on the side that the ray comes from; 0 for a miss.
        material: (N,) int64 rows of `Scene.palette`, -1 for a miss.
        mover: (N,) int64 rows of `Scene.movers`, `STATIC` for what stands still and for a miss.
        local: (N, 3) float64 metres: the point in the frame of the part (of the world, for what stands still).
    """

    distance_m: F64
    normal: F64
    material: I64
    mover: I64
    local: F64

    def __post_init__(self) -> None:
        n = len(self.distance_m)
        check_array("distance_m", self.distance_m, (n,), np.float64)
        check_array("normal", self.normal, (n, 3), np.float64)
        check_array("material", self.material, (n,), np.int64)
        check_array("mover", self.mover, (n,), np.int64)
        check_array("local", self.local, (n, 3), np.float64)

    def __len__(self) -> int:
        return len(self.distance_m)

    def select(self, rows: Bools | I64) -> "Hits":
        """Some of them."""
        rows = _numbers(rows)
        return Hits(*(getattr(self, name).take(rows, 0) for name in Hits.__slots__))

    @staticmethod
    def together(parts: Sequence["Hits"]) -> "Hits":
        """All of them, one after the other."""
        return Hits(*(np.concatenate([getattr(part, name) for part in parts]) for name in Hits.__slots__))


def _numbers(rows: Bools | I64) -> I64:
    """Rows as numbers: taken by these they come several times as fast as by a mask."""
    return np.flatnonzero(rows) if rows.dtype == np.bool_ else np.asarray(rows, np.int64)


def _tensor(origins: Floats, directions: Floats) -> Any:
    """Rays as Open3D takes them."""
    return open3d.core.Tensor.from_numpy(packed(origins, directions))


class _Body:
    """One mesh in the ray caster, and the rows of its materials in the scene's palette."""

    def __init__(self, mesh: Mesh, palette_rows: dict[Material, int]) -> None:
        self.rows = np.array([palette_rows[material] for material in mesh.palette], np.int64)[mesh.materials]
        self.bounds = low, high = mesh.bounds if len(mesh) else (np.zeros(3), np.zeros(3))
        self.center = (low + high) / 2
        self.radius = float(np.linalg.norm(mesh.vertices - self.center, axis=1).max(initial=0.0))
        self._caster: Any = open3d.t.geometry.RaycastingScene()
        if len(mesh):
            self._caster.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
        self._caster.cast_rays(_tensor(np.zeros((1, 3)), np.eye(1, 3)))  # it is built at the first ray: not by threads

    def cast(self, origins: F64, directions: F64) -> tuple[F64, F64, I64]:
        """Distance, normal as the triangles are turned, and material row; inf, 0 and -1 for a miss."""
        answer = self._caster.cast_rays(_tensor(origins, directions), nthreads=threads_for(len(origins)))
        distance = answer["t_hit"].numpy().astype(np.float64)
        normal, primitive = answer["primitive_normals"].numpy().astype(np.float64), answer["primitive_ids"].numpy()
        missed = np.flatnonzero(np.isinf(distance))
        if not len(self.rows):
            return distance, np.zeros_like(normal), np.full(len(distance), NO_MATERIAL, np.int64)
        primitive[missed] = 0
        material = self.rows.take(primitive)
        normal[missed], material[missed] = 0.0, NO_MATERIAL
        return distance, normal, material

    def seen(self, origin: F64, directions: F32) -> "Seen":
        """What rays from one point meet."""
        rays = packed(origin, directions)
        answer = self._caster.cast_rays(open3d.core.Tensor.from_numpy(rays), nthreads=threads_for(len(rays)))
        distance, normal = answer["t_hit"].numpy(), answer["primitive_normals"].numpy()
        met = np.isfinite(distance)
        if not len(self.rows):
            nothing = np.zeros_like(directions)
            return Seen(
                distance, nothing, np.full(len(rays), NO_MATERIAL, np.int64), nothing + origin.astype(np.float32)
            )
        triangle = answer["primitive_ids"].numpy()
        triangle *= met  # a miss has none
        material = self.rows.take(triangle)
        turn = np.where(dotted(normal, directions) > 0, np.float32(-1), np.float32(1)) * met
        reach = np.where(met, distance, np.float32(0))
        local = np.empty_like(directions)
        for axis, begin in enumerate(origin.astype(np.float32)):
            normal[:, axis] *= turn
            np.add(directions[:, axis] * reach, begin, out=local[:, axis])
        if not met.all():
            material[~met] = NO_MATERIAL
        return Seen(distance, normal, material, local)

    def distance(self, origin: F64, directions: F32) -> F32:
        """Distance (N,) along rays from one point; infinite for a miss."""
        rays = packed(origin, directions)
        answer = self._caster.cast_rays(open3d.core.Tensor.from_numpy(rays), nthreads=threads_for(len(rays)))
        return np.asarray(answer["t_hit"].numpy())

    def placed(self, path: Path, time_ns: int) -> PlacedPart:
        """Where it is at one moment."""
        pose = path.poses(np.array([time_ns], np.int64))
        rotation, translation = pose.rotation[0], pose.translation[0]
        return PlacedPart(self._caster, open3d.core.Tensor.from_numpy, self.rows, self.bounds, rotation, translation)

    def occludes(self, origins: Floats, directions: Floats, far_m: float) -> Bools:
        """Whether anything lies along each ray before `far_m`."""
        threads = threads_for(len(origins))
        return np.asarray(self._caster.test_occlusions(_tensor(origins, directions), 0.0, far_m, threads).numpy())


class Seen(NamedTuple):
    """What N rays from one point meet of what stands still.

    Attributes:
        distance: (N,) float32 metres; infinite for a miss.
        normal: (N, 3) float32 unit vectors on the side that the ray comes from; 0 for a miss.
        material: (N,) int64 rows of the palette, -1 for a miss.
        local: (N, 3) float32 metres, in the world.
    """

    distance: F32
    normal: F32
    material: I64
    local: F32


class Span:
    """A span of time, and where things are in it: looked up when first asked for, at moments close together."""

    def __init__(self, first_ns: int, last_ns: int) -> None:
        steps = -((first_ns - last_ns) // EVEN_NS)
        self._first_ns, self._steps = first_ns, steps
        self._step_ns = (last_ns - first_ns) / max(steps, 1)
        self._moments_ns = first_ns + np.rint(np.arange(steps + 1) * self._step_ns).astype(np.int64)
        self._found: dict[int, _Knots] = {}
        self._ways: dict[tuple[float, ...], tuple[F64, float]] = {}

    @classmethod
    def of(cls, rays: Rays) -> "Span":
        """The one in which N > 0 rays lie."""
        return cls(int(rays.times_ns.min()), int(rays.times_ns.max()))

    def poses(self, path: Path, times_ns: I64) -> Poses:
        """One pose for each of the times (N,), or one for all where the span is a moment."""
        knots = self._at_moments(path)
        if not self._steps:
            return knots.poses
        at = (times_ns - self._first_ns) / self._step_ns
        before = np.minimum(at.astype(np.int64), self._steps - 1)
        share = (at - before)[:, None]
        placed = knots.columns.take(before, 0) + share * knots.changes.take(before, 0)
        return Poses(placed[:, :9].reshape(-1, 3, 3), placed[:, 9:])

    def way(self, path: Path, point: F64) -> tuple[F64, float]:
        """The middle of the way of a point (3,) of something, and how far from it the way leads."""
        key = id(path), *point.tolist()
        if key not in self._ways:
            knots = self._at_moments(path).poses
            places = knots.rotation @ point + knots.translation
            middle = places.sum(0) / len(places)
            self._ways[key] = middle, float(np.sqrt(((places - middle) ** 2).sum(1).max()))
        return self._ways[key]

    def _at_moments(self, path: Path) -> "_Knots":
        if id(path) not in self._found:
            poses = path.poses(self._moments_ns)
            columns = np.concatenate([poses.rotation.reshape(-1, 9), poses.translation], axis=1)
            self._found[id(path)] = _Knots(path, poses, columns, np.diff(columns, axis=0))
        return self._found[id(path)]


class _Knots(NamedTuple):
    """A path at the moments of a span; it is kept with them so that no other one gets its id.

    Attributes:
        path: The path.
        poses: K poses.
        columns: (K, 12) rotation and translation.
        changes: (K - 1, 12) from each to the next.
    """

    path: Path
    poses: Poses
    columns: F64
    changes: F64


class Scene:
    """A world to cast rays at; its movers' paths may grow while it is used."""

    def __init__(self, static: Mesh, movers: Sequence[Mover]) -> None:
        self.movers = tuple(movers)
        meshes = [static, *(part.mesh for mover in movers for part in mover.parts)]
        self.palette = tuple(dict.fromkeys(material for mesh in meshes for material in mesh.palette))
        rows = {material: row for row, material in enumerate(self.palette)}
        self._static = _Body(static, rows)
        self._parts = tuple(tuple((_Body(part.mesh, rows), part.path) for part in mover.parts) for mover in movers)

    def cast(self, rays: Rays, span: "Span | None" = None) -> Hits:
        """The first surface along each ray, of anything; of surfaces at one distance the one that stands still.

        Args:
            rays: N rays.
            span: Of time, in which all of them lie; given to several casts it saves looking up again where things are.
        """
        columns = self._static_columns(rays)
        if len(rays):
            extent, span = _Extent(rays), span or Span.of(rays)
            for row in range(len(self.movers)):
                for rows, seen in self._cast_mover(row, rays, extent, span):
                    _put_nearer(columns, rows, seen)
        return Hits(*columns)

    def cast_static(self, rays: Rays) -> Hits:
        """The first surface along each ray, of what stands still; times do not matter."""
        return Hits(*self._static_columns(rays))

    def cast_mover(self, row: int, rays: Rays) -> tuple[I64, Hits]:
        """Which rays (K,) meet one mover, in rising order, and where they do (K)."""
        if not len(rays):
            return np.empty(0, np.int64), Hits(*_no_hits(0))
        columns = _no_hits(len(rays))
        for rows, seen in self._cast_mover(row, rays, _Extent(rays), Span.of(rays)):
            _put_nearer(columns, rows, seen)
        met = np.flatnonzero(np.isfinite(columns[0]))
        return met, Hits(*columns).select(met)

    def _static_columns(self, rays: Rays) -> Columns:
        distance, normal, material = self._static.cast(rays.origins, rays.directions)
        reach, local = np.where(np.isfinite(distance), distance, 0.0), np.empty_like(rays.origins)
        for axis in range(3):
            np.add(reach * rays.directions[:, axis], rays.origins[:, axis], out=local[:, axis])
        return distance, _facing(normal, rays.directions), material, np.full(len(rays), STATIC, np.int64), local

    def _cast_mover(self, row: int, rays: Rays, extent: "_Extent", span: "Span") -> Iterator[tuple[I64, Hits]]:
        """Which rays (K,) meet each part of a mover, in rising order, and where they do (K)."""
        mover = self.movers[row]
        middle, moved = span.way(mover.path, np.array(mover.box_center_m))
        radius = BOX_MARGIN * float(np.linalg.norm(mover.size_m)) / 2 + moved
        near = extent.passing(rays.directions, middle, radius)
        directions = rays.directions.take(near, 0)
        for body, path in self._parts[row] if len(near) else ():
            middle, moved = span.way(path, body.center)
            rows = near.take(extent.passing(directions, middle, body.radius + moved))
            if len(rows):
                some = rays.select(rows)
                met, seen = _cast_part(row, body, span.poses(path, some.times_ns), some)
                if len(met):
                    yield rows.take(met), seen

    def placed_parts(self, row: int, time_ns: int) -> list[PlacedPart]:
        """The parts of a mover at one moment, for a camera to cast at."""
        return [body.placed(path, time_ns) for body, path in self._parts[row]]

    def static_seen(self, origin: F64, directions: F32) -> "Seen":
        """What stands still in directions (N, 3) from one point (3,), in single precision, for images."""
        return self._static.seen(origin, directions)

    def static_distance(self, origin: F64, directions: F32) -> F32:
        """How far away (N,) what stands still is in directions (N, 3) from one point (3,); infinite for nothing."""
        return self._static.distance(origin, directions)

    def static_between(self, points: Floats, towards: Floats) -> Bools:
        """Whether what stands still lies in directions (N, 3), each its own, from points (N, 3)."""
        return self._static.occludes(points, towards, np.inf)

    def shaded_by_static(self, points: Floats, towards: F64) -> Bools:
        """Whether what stands still keeps the light of a direction (3,) from points (N, 3)."""
        return self._static.occludes(points, towards, np.inf)

    def shaded_by_mover(self, row: int, points: F64, towards: F64, time_ns: int) -> Bools:
        """Whether a mover keeps the light of a direction (3,) from points (N, 3) at one time."""
        shaded = np.zeros(len(points), np.bool_)
        directions = np.broadcast_to(towards, points.shape)
        for body, path in self._parts[row]:
            pose = path.poses(np.array([time_ns], np.int64))
            middle = pose.apply(body.center[None])[0]
            near = np.flatnonzero(~shaded & _passes(points, directions, middle, body.radius))
            if len(near):
                to_part = pose.inverse()
                shaded[near] = body.occludes(to_part.apply(points[near]), to_part.turn(directions[near]), np.inf)
        return shaded


def with_nearer(hits: Hits, rows: I64, others: Hits) -> Hits:
    """Hits (N) with those of `others` (K), which belong to the rays `rows` (K,), wherever these are nearer."""
    columns = hits.distance_m.copy(), hits.normal.copy(), hits.material.copy(), hits.mover.copy(), hits.local.copy()
    _put_nearer(columns, rows, others)
    return Hits(*columns)


def _put_nearer(columns: Columns, rows: I64, others: Hits) -> None:
    """Put others into the columns of hits wherever they are nearer, see `with_nearer`."""
    closer = np.flatnonzero(others.distance_m < columns[0].take(rows))
    changed = rows.take(closer)
    for column, name in zip(columns, Hits.__slots__, strict=True):
        column[changed] = getattr(others, name).take(closer, 0)


def _no_hits(n: int) -> Columns:
    nothing = np.full(n, NO_MATERIAL, np.int64)
    return np.full(n, np.inf), np.zeros((n, 3)), nothing, np.full(n, STATIC, np.int64), np.zeros((n, 3))


def _cast_part(row: int, body: _Body, poses: Poses, rays: Rays) -> tuple[I64, Hits]:
    """Which rays (K,) meet a part of the mover `row`, in rising order, and where they do (K)."""
    back = poses.rotation.transpose(0, 2, 1)
    origins, directions = turned(back, rays.origins - poses.translation), turned(back, rays.directions)
    near = None
    if len(rays) > FEW_RAYS:  # fewer are cast sooner than sorted out
        near = np.flatnonzero(_passes(origins, directions, body.center, body.radius))
        origins, directions = origins.take(near, 0), directions.take(near, 0)
    distance, normal, material = body.cast(origins, directions)
    hit = np.flatnonzero(np.isfinite(distance))
    met, directions, distance = hit if near is None else near.take(hit), directions.take(hit, 0), distance.take(hit)
    rotation = poses.rotation if len(poses) == 1 else poses.rotation.take(met, 0)
    normal = turned(rotation, _facing(normal.take(hit, 0), directions))
    local = origins.take(hit, 0) + directions * distance[:, None]
    return met, Hits(distance, normal, material.take(hit), np.full(len(met), row, np.int64), local)


class _Extent:
    """Where rays begin, to find with little work most of those that stay away from something."""

    def __init__(self, rays: Rays) -> None:
        columns = [rays.origins[:, axis] for axis in range(3)]
        low, high = np.array([(column.min(), column.max()) for column in columns]).T
        self._middle, self._spread = (low + high) / 2, float(np.linalg.norm(high - low)) / 2

    def passing(self, directions: F64, center: F64, radius: float) -> I64:
        """Which of some of the rays, of directions (N, 3), may meet a sphere."""
        # A ray from elsewhere meets no sphere that the same ray from the middle misses by as much as it was shifted.
        reach, offset = radius + self._spread, center - self._middle
        least2 = float(offset @ offset) - reach * reach
        if least2 <= 0:
            return np.arange(len(directions))
        return np.flatnonzero(dotted(directions, offset) >= np.sqrt(least2))


def _facing(normal: F64, directions: F64) -> F64:
    """Normals turned against the rays, in place."""
    turn = np.where(dotted(normal, directions) > 0, -1.0, 1.0)
    for axis in range(3):
        normal[:, axis] *= turn
    return normal


def _passes(origins: F64, directions: F64, center: F64, radius: float) -> Bools:
    """Whether each ray meets a sphere: (N,)."""
    x, y, z = (middle - origins[:, axis] for axis, middle in enumerate(center.tolist()))
    along = x * directions[:, 0] + y * directions[:, 1] + z * directions[:, 2]
    across2 = x * x + y * y + z * z - along * along
    return np.asarray((across2 <= radius * radius) & (along >= -radius))
