"""Things to look at for the tests of simulated sensors: scenes of few bodies, and ways that are known by formula."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.bags.simulator.world.mesh import Material, Mesh, box, merged, polygon
from lidcam.bags.simulator.world.motion import FixedPath, Mover, Part, Path, Poses, UprightBox, upright_poses
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.geometry.transform import Transform

WHITE = Material("white", (1.0, 1.0, 1.0), 1.0)
GREY = Material("grey", (0.5, 0.5, 0.5), 0.25)
BLACK = Material("black", (0.0, 0.0, 0.0), 0.01)
RETRO = Material("reflector", (1.0, 1.0, 1.0), 5.0)
GLASS = Material("glass", (0.1, 0.1, 0.1), 0.01, mirror=0.1, transmission=0.8)


@dataclass(frozen=True, slots=True)
class EvenPath:
    """Upright, at an even pace and turning evenly."""

    start_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    turn_rad_s: float = 0.0

    def poses(self, times_ns: I64) -> Poses:
        """As `Path`."""
        seconds: F64 = times_ns.astype(np.float64) * 1e-9
        places = np.array(self.start_m) + seconds[:, None] * np.array(self.velocity_m_s)
        return upright_poses(places, self.yaw_rad + self.turn_rad_s * seconds)


def fixed_at(position_m: Sequence[float]) -> FixedPath:
    """Something that stands still."""
    return FixedPath(Transform.from_quaternion("world", "thing", position_m, (0, 0, 0, 1)))


def wall(x_m: float, material: Material, *, half_m: float = 50.0) -> Mesh:
    """A square in the plane of one x, seen from the origin."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half_m
    if x_m < 0:
        corners = corners[::-1]
    return polygon(np.c_[np.full(4, x_m), corners], material)


def box_mover(
    name: str, path: Path, size_m: tuple[float, float, float] = (4.0, 2.0, 1.5), material: Material = GREY
) -> Mover:
    """A box that stands on the ground at its path's place."""
    center = (0.0, 0.0, size_m[2] / 2)
    return Mover(
        name, "car", path, center, size_m, (Part(box(center, size_m, material), path),), UprightBox(center, size_m)
    )


def scene(meshes: Sequence[Mesh] = (), movers: Sequence[Mover] = ()) -> Scene:
    """What stands still and what moves."""
    return Scene(merged(*meshes), movers)
