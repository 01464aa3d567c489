import numpy as np
import pytest
from meshes import open_edges, signed_volume
from small_worlds import BLACK, GREY, WHITE

from lidcam.bags.simulator.world.bodies.hulls import Hull, both_sides
from lidcam.bags.simulator.world.mesh import (
    box,
    cylinder,
    ellipses,
    limb,
    loft,
    merged,
    panel,
    polygon,
    prism,
    sphere,
    torus,
)

SQUARE = [[1, 1], [-1, 1], [-1, -1], [1, -1]]
PLAIN_HULL = Hull(((0.0, 1.0, 2.0), (4.0, 1.0, 2.0)), ((0.5, 1.0), (1.0, 1.0), (2.0, 1.0)), 0.5, (), 0.0, 0.0)
ARCHED_HULL = Hull(((0.0, 1.0, 2.0), (4.0, 1.0, 2.0)), ((0.5, 1.0), (1.0, 1.0), (2.0, 1.0)), 0.5, (1.0, 3.0), 0.4, 0.5)


def rings(*heights: float) -> list[np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    return [np.c_[SQUARE, np.full(4, height)] for height in heights]


BODIES = {
    "box": (box((1, 2, 3), (4, 2, 1), GREY, yaw=0.7), 8.0, 1e-9),
    "prism": (prism(SQUARE, 1.0, 3.0, GREY), 8.0, 1e-9),
    "cylinder": (cylinder((0, 0, 0), (0, 3, 4), 1.0, GREY, sides=64), 5 * np.pi, 0.01),
    "cone": (cylinder((1, 1, 0), (1, 1, 3), 1.0, GREY, sides=64, taper=1e-6), np.pi, 0.01),
    "sphere": (sphere((5, 5, 5), 1.0, GREY, sides=64), 4 / 3 * np.pi, 0.01),
    "loft": (loft(rings(0, 1, 3), GREY), 12.0, 1e-9),
    "loft, downwards": (loft(rings(3, 0), GREY), 12.0, 1e-9),
    "ellipses": (ellipses([(0, 0, 0, 2, 1), (3, 0, 0, 2, 1)], GREY, sides=64), 6 * np.pi, 0.01),
    "limb": (limb([(0, 0, 0), (0, 0, 2), (0, 2, 2)], (1, 1, 1), GREY, sides=64), 4 * np.pi, 0.01),
    "torus": (torus((1, 2, 3), 3.0, 2.0, GREY, sides=64, around=64), 2 * np.pi**2 * 2, 0.01),
    "panel": (panel([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]], GREY, thickness=0.5), 3.0, 1e-9),
    "hull": (PLAIN_HULL.mesh(GREY, below=BLACK), 4 * 2 * 1.5, 1e-9),
    "hull with arches": (ARCHED_HULL.mesh(GREY, below=BLACK), 12.0 - 2 * 2 * np.pi * 0.4**2 / 2, 0.01),
    "both sides": (both_sides(box((0, 3, 0), (1, 1, 1), GREY)), 2.0, 1e-9),
}


@pytest.mark.parametrize("name", BODIES)
def test_bodies_are_closed_and_face_outwards(name: str) -> None:
    mesh, volume, tolerance = BODIES[name]
    assert signed_volume(mesh) == pytest.approx(volume, rel=tolerance)
    assert open_edges(mesh) == 0


def test_merged_meshes_keep_their_materials() -> None:
    parts = [box((0, 0, 0), (1, 1, 1), WHITE), polygon([[0, 0, 0], [1, 0, 0], [0, 1, 0]], BLACK)]
    mesh = merged(*parts, box((5, 0, 0), (1, 1, 1), WHITE))
    assert mesh.palette == (WHITE, BLACK)
    assert np.bincount(mesh.materials).tolist() == [24, 1]
    assert mesh.triangles.max() == len(mesh.vertices) - 1
    assert len(merged()) == 0


def test_a_loft_knows_the_material_of_each_face() -> None:
    mesh = loft(
        rings(0, 1, 2), GREY, where=lambda ring, side: WHITE if (ring, side) == (1, 0) else GREY, ends=(BLACK, BLACK)
    )
    white = mesh.materials == mesh.palette.index(WHITE)
    corners = mesh.vertices[mesh.triangles[white]]
    assert white.sum() == 2
    assert corners[..., 2].min() == 1
    np.testing.assert_array_equal(corners[..., 1], 1)
    assert (mesh.materials == mesh.palette.index(BLACK)).sum() == 4
