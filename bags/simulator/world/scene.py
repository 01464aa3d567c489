"""Ray casting into a world that moves while the rays are cast.

The static world is one body in Open3D's ray caster (Embree), and so is each moving part, in its own frame. Each ray is
transformed into a part's frame at the time of that ray, so that moving things look skewed to a turning lidar, as in
reality. Rays that miss a thing's bounding sphere are not cast at it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from lidcam.bags.simulator.world.mesh import Material, Mesh
from lidcam.bags.simulator.world.motion import Mover, Path, Poses, Span, turned
from lidcam.bags.simulator.world.open3d_runtime import load_open3d
from lidcam.pipeline.core.arrays import F32, F64, I64, U32, Bools, Table

Floats = F32 | F64
Real = TypeVar("Real", np.float32, np.float64)

STATIC = -1  # mover row of the static world
NO_MATERIAL = -1  # material row of a miss
MIN_PARALLEL_RAYS = 4096  # fewer rays are cast by a single thread: waking others costs more


@dataclass(frozen=True, slots=True, eq=False)
class Rays(Table):
    """Rays in the world frame."""

    origins: F64  # (N, 3) metres
    directions: F64  # (N, 3) unit vectors
    times_ns: I64  # (N,) since the start of the scenario


@dataclass(frozen=True, slots=True, eq=False)
class Hits(Table):
    """The first surface along each of N rays."""

    distance_m: F64  # (N,); infinite for a miss
    normal: F64  # (N, 3) unit vectors in the world, towards the side the ray comes from; 0 for a miss
    material: I64  # (N,) rows of `Scene.palette`, `NO_MATERIAL` for a miss
    mover: I64  # (N,) rows of `Scene.movers`, `STATIC` for the static world and for a miss
    local: F64  # (N, 3) the point in the frame of the part (the world frame for the static world), metres


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces(Table):
    """The surfaces that N rays from one point hit."""

    directions: F32  # (N, 3) unit vectors in the world
    distance: F32  # (N,) metres; the rest as in `Hits`
    normal: F32
    material: I64
    local: F32
    origin: tuple[float, ...]  # x, y, z of the rays in the world

    @property
    def points(self) -> F32:
        """(N, 3) metres in the world, lifted off the surface so that rays from there do not hit it by rounding."""
        distance = np.where(np.isfinite(self.distance), self.distance, np.float32(0))
        lift = np.float32(5e-4) + np.float32(2e-5) * distance
        lifted = self.directions * distance[:, None] + lift[:, None] * self.normal
        return np.asarray(lifted + np.array(self.origin, np.float32), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class PartHits:
    """The hits of N rays on a part."""

    rows: I64  # (K,) rows of the rays that hit it, rising
    distance: F32  # (K,) metres
    face: F32  # (N, 3) normal of the triangle hit, in the part's frame
    triangle: U32  # (N,) row of that triangle


def packed(origins: Floats, directions: Floats) -> F32:
    """Rays (N, 6) for the ray caster from origins and directions (N, 3); one of the two may be (3,) for all rays."""
    rays = np.empty((len(directions) if directions.ndim == 2 else len(origins), 6), np.float32)
    rays[:, :3], rays[:, 3:] = origins, directions
    return rays


def threads_for(rays: int) -> int:
    """Number of threads for a number of rays; 0 for one per processor."""
    return 1 if rays < MIN_PARALLEL_RAYS else 0


def dotted(a: npt.NDArray[Real], b: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Dot products (N,) of vectors (N, 3) with vectors (N, 3), or with one (3,)."""
    products: npt.NDArray[Real] = a[:, 0] * b[..., 0]
    products += a[:, 1] * b[..., 1]
    products += a[:, 2] * b[..., 2]
    return products


def passing_rays(points: Floats, towards: F64, center: F64, radius: float) -> I64:
    """Rows of the points (N, 3) whose rays, in directions (N, 3) or one direction (3,), hit a sphere."""
    x, y, z = (middle - points[:, axis] for axis, middle in enumerate(center.tolist()))
    a, b, c = towards.astype(points.dtype, copy=False).T
    along = x * a + y * b + z * c
    across2 = x * x + y * y + z * z - along * along
    return np.flatnonzero((across2 <= radius * radius) & (along >= -radius))


def mapped(vectors: F32, matrix: Floats, shift: Floats | None = None) -> F32:
    """Vectors (N, 3) times a matrix, plus a shift; with so few columns ten times as fast as numpy."""
    if not len(vectors):
        return np.empty((0, 3), np.float32)
    affine = matrix if shift is None else np.c_[matrix, shift]
    return np.asarray(cv2.transform(vectors[:, None], affine.astype(np.float32)).reshape(-1, 3), np.float32)


open3d = load_open3d()

BOX_MARGIN = 1.2  # enlargement of a mover's box so that the sphere around it holds limbs that stick out of it
_UNIT_CORNERS = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T


class Body:
    """A mesh in the ray caster, with the palette row of each of its triangles."""

    def __init__(self, mesh: Mesh, palette_rows: dict[Material, int]) -> None:
        rows = np.array([palette_rows[material] for material in mesh.palette], np.int64)[mesh.materials]
        self.rows = rows if len(mesh) else np.array([NO_MATERIAL])  # a miss looks up row 0
        self.bounds = low, high = mesh.bounds if len(mesh) else (np.zeros(3), np.zeros(3))
        self.center = (low + high) / 2
        self.radius = float(np.linalg.norm(mesh.vertices - self.center, axis=1).max(initial=0.0))
        self._caster: Any = open3d.t.geometry.RaycastingScene()
        if len(mesh):
            self._caster.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
        self.answer(np.zeros((1, 3)), np.eye(1, 3))  # builds the tree here, not in a thread

    def answer(self, origins: F64, directions: Floats) -> Any:
        """Open3D's answer to rays; see `packed`."""
        rays = packed(origins, directions)
        return self._caster.cast_rays(open3d.core.Tensor.from_numpy(rays), nthreads=threads_for(len(rays)))

    def cast(self, origins: F64, directions: F64) -> tuple[F64, F64, I64]:
        """Distance, normal of the triangle and material row (N); inf, 0 and -1 for a miss."""
        answer = self.answer(origins, directions)
        distance = answer["t_hit"].numpy().astype(np.float64)
        normal, primitive = answer["primitive_normals"].numpy().astype(np.float64), answer["primitive_ids"].numpy()
        missed = np.flatnonzero(np.isinf(distance))
        primitive[missed] = 0
        material = self.rows.take(primitive)
        normal[missed], material[missed] = 0.0, NO_MATERIAL
        return distance, normal, material

    def surfaces(self, origin: F64, directions: F32) -> Surfaces:
        """The surfaces that rays from one point hit."""
        answer = self.answer(origin, directions)
        distance, normal = answer["t_hit"].numpy(), answer["primitive_normals"].numpy()
        met = np.isfinite(distance)
        triangle = answer["primitive_ids"].numpy()
        triangle *= met  # a miss has no valid id
        material = self.rows.take(triangle)
        normal *= (np.where(dotted(normal, directions) > 0, np.float32(-1), np.float32(1)) * met)[:, None]
        reach = np.where(met, distance, np.float32(0))
        local = directions * reach[:, None] + origin.astype(np.float32)
        material[~met] = NO_MATERIAL
        return Surfaces(directions, distance, normal, material, local, tuple(origin))

    def occludes(self, origins: Floats, directions: Floats) -> Bools:
        """Whether each ray hits it."""
        rays = packed(origins, directions)
        tensor, threads = open3d.core.Tensor.from_numpy(rays), threads_for(len(rays))
        return np.asarray(self._caster.test_occlusions(tensor, nthreads=threads).numpy())


class PlacedPart:
    """A body on a path at one time, for a camera to cast at in single precision."""

    def __init__(self, body: Body, path: Path, time_ns: int) -> None:
        pose = path.poses(np.array([time_ns], np.int64))
        rotation, translation = pose.rotation[0], pose.translation[0]
        self._body, self._rotation, self._translation = body, rotation, translation
        low, high = body.bounds
        self.corners: F64 = (low + _UNIT_CORNERS * (high - low)) @ rotation.T + translation
        self._center: F64 = (low + high) / 2 @ rotation.T + translation
        self._radius = float(np.linalg.norm(high - low)) / 2

    def cast(self, origin: F64, directions: F32) -> PartHits:
        """The hits of rays from one point (3,) along unit vectors (N, 3), all in the world."""
        begin = (origin - self._translation) @ self._rotation
        answer = self._body.answer(begin, mapped(directions, self._rotation.T))
        distance = answer["t_hit"].numpy()
        rows = np.flatnonzero(np.isfinite(distance))
        face, triangle = answer["primitive_normals"].numpy(), answer["primitive_ids"].numpy()
        return PartHits(rows, distance.take(rows), face, triangle)

    def surfaces(self, hits: PartHits, some: I64, origin: F64, directions: F32) -> Surfaces:
        """The surfaces that some of the rays hit: rows (K,) of `hits.rows`, with directions (K, 3) in the world."""
        rays, distance = hits.rows.take(some), hits.distance.take(some)
        normal = mapped(hits.face.take(rays, 0), self._rotation)
        turn = np.where(dotted(normal, directions) > 0, np.float32(-1), np.float32(1))
        begin, ahead = (origin - self._translation) @ self._rotation, mapped(directions, self._rotation.T)
        local = ahead * distance[:, None] + begin.astype(np.float32)
        material = self._body.rows.take(hits.triangle.take(rays))
        return Surfaces(directions, distance, normal * turn[:, None], material, local, tuple(origin))

    def occludes(self, points: F32, towards: F64) -> Bools:
        """Whether the part blocks light from a direction (3,) at points (N, 3) of the world."""
        shaded = np.zeros(len(points), np.bool_)
        near = passing_rays(points, towards, self._center, 1.001 * self._radius + 1e-4)
        if len(near):
            begins = mapped(points.take(near, 0), self._rotation.T, -self._translation @ self._rotation)
            shaded[near] = self._body.occludes(begins, towards @ self._rotation)
        return shaded


class Scene:
    """A world to cast rays into; the paths of its movers may grow between casts."""

    def __init__(self, static: Mesh, movers: Sequence[Mover]) -> None:
        self.movers = tuple(movers)
        meshes = [static, *(part.mesh for mover in movers for part in mover.parts)]
        self.palette = tuple(dict.fromkeys(material for mesh in meshes for material in mesh.palette))
        rows = {material: row for row, material in enumerate(self.palette)}
        self.static = Body(static, rows)
        self._parts = tuple(tuple((Body(part.mesh, rows), part.path) for part in mover.parts) for mover in movers)

    def cast(self, rays: Rays, span: Span | None = None) -> Hits:
        """The first surface along each ray; of surfaces at the same distance the static one.

        Sharing the time span of all rays between casts saves sampling the paths again.
        """
        distance, normal, material = self.static.cast(rays.origins, rays.directions)
        local = np.where(np.isfinite(distance), distance, 0.0)[:, None] * rays.directions + rays.origins
        static = np.full(len(rays), STATIC, np.int64)
        hits = Hits(distance, _facing(normal, rays.directions), material, static, local)
        if len(rays):
            extent, span = _Extent(rays), span or Span(rays.times_ns)
            for row in range(len(self.movers)):
                for rows, seen in self._cast_mover(row, rays, extent, span):
                    _put_nearer(hits, rows, seen)
        return hits

    def _cast_mover(self, row: int, rays: Rays, extent: "_Extent", span: Span) -> Iterator[tuple[I64, Hits]]:
        """Rows (K,) of the rays that hit a part of a mover, rising, and the hits (K), part by part."""
        mover = self.movers[row]
        middle, moved = span.sphere(mover.path, np.array(mover.box_center_m))
        radius = BOX_MARGIN * float(np.linalg.norm(mover.size_m)) / 2 + moved
        near = extent.passing(rays.directions, middle, radius)
        directions = rays.directions.take(near, 0)
        for body, path in self._parts[row] if len(near) else ():
            middle, moved = span.sphere(path, body.center)
            rows = near.take(extent.passing(directions, middle, body.radius + moved))
            if len(rows):
                some = rays.select(rows)
                met, seen = _cast_part(row, body, span.poses(path, some.times_ns), some)
                if len(met):
                    yield rows.take(met), seen

    def placed_parts(self, row: int, time_ns: int) -> list[PlacedPart]:
        """The parts of a mover at one time, for a camera to cast at."""
        return [PlacedPart(body, path, time_ns) for body, path in self._parts[row]]


def _put_nearer(hits: Hits, rows: I64, others: Hits) -> None:
    """Write the hits of `others` (K), which belong to the rays `rows` (K,), into `hits` where they are nearer."""
    closer = np.flatnonzero(others.distance_m < hits.distance_m.take(rows))
    changed = rows.take(closer)
    for name in Hits.__slots__:
        getattr(hits, name)[changed] = getattr(others, name).take(closer, 0)


def _cast_part(row: int, body: Body, poses: Poses, rays: Rays) -> tuple[I64, Hits]:
    """Rows (K,) of the rays that hit a part of the mover `row`, rising, and the hits (K)."""
    back = poses.rotation.transpose(0, 2, 1)
    origins, directions = turned(back, rays.origins - poses.translation), turned(back, rays.directions)
    near = None
    if len(rays) > MIN_PARALLEL_RAYS:  # casting fewer is faster than sorting them out
        near = passing_rays(origins, directions, body.center, body.radius)
        origins, directions = origins.take(near, 0), directions.take(near, 0)
    distance, normal, material = body.cast(origins, directions)
    hit = np.flatnonzero(np.isfinite(distance))
    met, directions, distance = hit if near is None else near.take(hit), directions.take(hit, 0), distance.take(hit)
    rotation = poses.rotation if len(poses) == 1 else poses.rotation.take(met, 0)
    normal = turned(rotation, _facing(normal.take(hit, 0), directions))
    local = origins.take(hit, 0) + directions * distance[:, None]
    return met, Hits(distance, normal, material.take(hit), np.full(len(met), row, np.int64), local)


class _Extent:
    """The extent of ray origins: a cheap test that rules out most rays that miss something."""

    def __init__(self, rays: Rays) -> None:
        columns = [rays.origins[:, axis] for axis in range(3)]
        low, high = np.array([(column.min(), column.max()) for column in columns]).T
        self._middle, self._spread = (low + high) / 2, float(np.linalg.norm(high - low)) / 2

    def passing(self, directions: F64, center: F64, radius: float) -> I64:
        """Rows of the rays with directions (N, 3) that may hit a sphere."""
        # Starting all rays in the middle shifts them by at most the spread, so the sphere grows by that.
        reach, offset = radius + self._spread, center - self._middle
        least2 = float(offset @ offset) - reach * reach
        if least2 <= 0:
            return np.arange(len(directions))
        return np.flatnonzero(dotted(directions, offset) >= np.sqrt(least2))


def _facing(normal: F64, directions: F64) -> F64:
    """Normals flipped to face the rays, in place."""
    normal *= np.where(dotted(normal, directions) > 0, -1.0, 1.0)[:, None]
    return normal
