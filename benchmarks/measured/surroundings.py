"""Names for false detections: the things that stand where a result reports an object."""

from collections import Counter

import numpy as np

from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.world.open3d_runtime import load_open3d
from lidcam.bags.simulator.world.places.places import mesh_of
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.boxes import rotations_2d

NOTHING = "nothing that stands there"

GROUNDS = ("crossing ground", "street ground", "paving", "table top", "room floor", "kerb", "model kerb", "island")
"""Materials that lie below everything: named only where there is nothing else."""

NOUNS = {"bark": "tree", "leaves": "tree", "needles": "conifer", "galvanised pole": "pole", "lamp": "lamp post"}
"""Things made of a material that has another name."""

STEPS = 9


class Surroundings:
    """The static part of a simulated world.

    Args:
        scenario: Of the world.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._mesh = mesh_of(scenario)
        open3d = load_open3d()
        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        vertices, triangles = self._mesh.vertices.astype(np.float32), self._mesh.triangles.astype(np.uint32)
        self._scene.add_triangles(self._tensor(vertices), self._tensor(triangles))

    def name(self, center: F64, size_m: F64, yaw: float) -> str:
        """The thing that fills most of a box: that with most of the surfaces that are nearest to points in the box.

        Args:
            center: (3,) metres in the world.
            size_m: (3,) length, width, height.
            yaw: About +z, radians.
        """
        steps = (np.arange(STEPS) + 0.5) / STEPS - 0.5
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3) * size_m
        (turn,) = rotations_2d(np.array([yaw]))
        points = np.column_stack([grid[:, :2] @ turn.T, grid[:, 2]]) + center
        nearest = self._scene.compute_closest_points(self._tensor(points.astype(np.float32)))
        surfaces, triangles = nearest["points"].numpy(), nearest["primitive_ids"].numpy().astype(np.int64)
        local = (surfaces - center)[:, :2] @ turn
        inside = (np.abs(np.column_stack([local, (surfaces - center)[:, 2]])) <= size_m / 2 + 1e-3).all(1)
        materials = (self._mesh.palette[row].name for row in self._mesh.materials[triangles[inside]])
        found = Counter(_noun(material) for material in materials)
        things = [name for name, _ in found.most_common() if name not in GROUNDS] or [
            f"the ground ({name})" for name, _ in found.most_common(1)
        ]
        return things[0] if things else NOTHING


def _noun(material: str) -> str:
    plain = material.partition(" (")[0].rstrip(" 0123456789")
    return NOUNS.get(plain, plain)
