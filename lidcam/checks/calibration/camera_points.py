"""Cameras into whose images no lidar point falls."""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.run.warning import RunWarning

MAX_POINTS, MAX_CLOUDS = 3000, 20
"""Points of a cloud that are projected, every n-th of it, and clouds that are looked at."""

MIN_POINTS = 500
"""Fewer points may miss an image by chance."""


class CameraPoints:
    """Looks for points in each image until there is one, in the first clouds."""

    def __init__(self, rig: Rig) -> None:
        self._cameras = {camera.name: camera for camera in rig.cameras}
        self._inverse = dict.fromkeys(self._cameras, 0)
        self._points = self._clouds = 0

    def add(self, *parts_xyz_site: F32) -> None:
        """Look at one cloud: (N, 3) points of each part of it in the site frame, metres."""
        if not self._cameras or not any(map(len, parts_xyz_site)) or self._clouds == MAX_CLOUDS:
            return
        xyz_site = np.concatenate(parts_xyz_site)
        sample = xyz_site[:: -(-len(xyz_site) // MAX_POINTS)].astype(np.float64)
        self._clouds += 1
        self._points += len(sample)
        for camera in [*self._cameras.values()]:
            if _in_image(camera, camera.T_camera_site, sample):
                del self._cameras[camera.name]
            else:
                inverse = camera.T_camera_site.inverse()
                as_given = Transform(inverse.src, inverse.dst, inverse.matrix)
                self._inverse[camera.name] += _in_image(camera, as_given, sample)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each camera without a point in its image."""
        if self._points < MIN_POINTS:
            return ()
        return tuple(self._warning(name) for name in self._cameras)

    def _warning(self, name: str) -> RunWarning:
        finding = f"none of {self._points} lidar points of {self._clouds} clouds falls into its image"
        remedy = "check its extrinsics and the frame that they are given in"
        if inverse := self._inverse[name]:
            finding += f" ({inverse} do with the inverse of its extrinsics)"
            remedy += ", and whether T_camera_site (site to camera) and T_site_camera are mixed up"
        return RunWarning(name, finding, remedy)


def _in_image(camera: CameraSensor, T_camera_site: Transform, xyz_site: F64) -> int:
    """Number of points (N, 3) in the image."""
    pixels, valid = camera.model.project(T_camera_site.apply(xyz_site))
    size = np.array([camera.model.width_px, camera.model.height_px])
    return int((valid & (pixels >= 0).all(-1) & (pixels < size).all(-1)).sum())
