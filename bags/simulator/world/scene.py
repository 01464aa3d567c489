"""Ray casting into a world that moves while the rays are cast.

The static world is one body in Open3D's ray caster (Embree), and so is each moving part, in its own frame. Each ray is
transformed into a part's frame at the time of that ray, so that moving things look skewed to a turning lidar, as in
reality. Rays that miss a thing's bounding sphere are not cast at it.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from lidcam.bags.simulator.world.mesh import Material, Mesh
from lidcam.bags.simulator.world.motion import Mover, Path, Poses, Span, turned
from lidcam.bags.simulator.world.open3d_runtime import load_open3d
from lidcam.bags.simulator.world.rays import (
    MIN_PARALLEL_RAYS,
    NO_MATERIAL,
    STATIC,
    Floats,
    Hits,
    PartHits,
    PartSurfaces,
    Rays,
    Surfaces,
    dotted,
    mapped,
    packed,
    passing_rays,
    threads_for,
)
from lidcam.pipeline.core.arrays import F32, F64, I64, Bools

open3d = load_open3d()

Columns = tuple[F64, F64, I64, I64, F64]

BOX_MARGIN = 1.2
"""Enlargement of a mover's box so that the sphere around it holds all parts: limbs may stick out of the box."""

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
        return Surfaces(origin, directions, distance, normal, material, local)

    def distance(self, origin: F64, directions: F32) -> F32:
        """Distance (N,) along rays from one point; infinite for a miss."""
        return np.asarray(self.answer(origin, directions)["t_hit"].numpy())

    def occludes(self, origins: Floats, directions: Floats) -> Bools:
        """Whether each ray hits it."""
        rays = packed(origins, directions)
        tensor, threads = open3d.core.Tensor.from_numpy(rays), threads_for(len(rays))
        return np.asarray(self._caster.test_occlusions(tensor, nthreads=threads).numpy())


class PlacedPart:
    """A body on a path at one time, for a camera to cast at in single precision."""

    def __init__(self, body: Body, path: Path, time_ns: int) -> None:
        pose = path.poses(np.array([time_ns], np.int64))
        self._body, self._rotation, self._translation = body, pose.rotation[0], pose.translation[0]
        rotation, translation = self._rotation, self._translation
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

    def surfaces(self, hits: PartHits, some: I64, origin: F64, directions: F32) -> PartSurfaces:
        """The surfaces that some of the rays hit: rows (K,) of `hits.rows`, with directions (K, 3) in the world."""
        rays, distance = hits.rows.take(some), hits.distance.take(some)
        normal = mapped(hits.face.take(rays, 0), self._rotation)
        turn = np.where(dotted(normal, directions) > 0, np.float32(-1), np.float32(1))
        begin, ahead = (origin - self._translation) @ self._rotation, mapped(directions, self._rotation.T)
        local = ahead * distance[:, None] + begin.astype(np.float32)
        return PartSurfaces(normal * turn[:, None], self._body.rows.take(hits.triangle.take(rays)), local)

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
        columns = self._static_columns(rays)
        if len(rays):
            extent, span = _Extent(rays), span or Span(rays.times_ns)
            for row in range(len(self.movers)):
                for rows, seen in self._cast_mover(row, rays, extent, span):
                    _put_nearer(columns, rows, seen)
        return Hits(*columns)

    def _static_columns(self, rays: Rays) -> Columns:
        distance, normal, material = self.static.cast(rays.origins, rays.directions)
        local = np.where(np.isfinite(distance), distance, 0.0)[:, None] * rays.directions + rays.origins
        return distance, _facing(normal, rays.directions), material, np.full(len(rays), STATIC, np.int64), local

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


def _put_nearer(columns: Columns, rows: I64, others: Hits) -> None:
    """Write the hits of `others` (K), which belong to the rays `rows` (K,), into the columns where they are nearer."""
    closer = np.flatnonzero(others.distance_m < columns[0].take(rows))
    changed = rows.take(closer)
    for column, name in zip(columns, Hits.__slots__, strict=True):
        column[changed] = getattr(others, name).take(closer, 0)


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
