"""Cameras with every lens model, for tests."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.camera import CameraModel, DistortionModel

LENS_MODELS: dict[str, tuple[DistortionModel, list[float]]] = {
    "none": ("plumb_bob", []),
    "plumb_bob_4": ("plumb_bob", [-0.1192, 0.162, 0.00073985, 0.0014]),
    "plumb_bob_5": ("plumb_bob", [-0.102933, -0.040925, 0.00057951, -0.00419933, 0.429959]),
    "plumb_bob_folding": ("plumb_bob", [-0.3, 0.02]),
    "rational": ("rational_polynomial", [0.3, -0.1, 0.001, -0.002, 0.02, 0.5, -0.05, 0.01]),
    "equidistant": ("equidistant", [-0.01, 0.02, -0.005, 0.001]),
    "equidistant_ideal": ("equidistant", []),
}
"""Distortion models by a name for them."""


def lens(model: DistortionModel, distortion: Sequence[float]) -> CameraModel:
    """A camera of 640 x 480 pixels with skew, whose axes have different focal lengths."""
    K = np.array([[520.0, 2.0, 333.0], [0, 510, 251], [0, 0, 1]])
    return CameraModel("cam", 640, 480, K, model, np.array(distortion, np.float64))
