"""Networks in pillars from ONNX files, as `lidcam train pillars` writes them."""

from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from pydantic import Field, ValidationError

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.model import Positive, SettingsModel
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.detectors.onnx.session import OnnxSession
from lidcam.pipeline.detectors.pillars.decoding import BOX_NUMBERS, Found, boxes_of
from lidcam.pipeline.detectors.pillars.grid import FEATURES, STRIDE, Grid, pillars

KEY = "lidcam.pillars"
"""Name under which the metadata of a file holds its `PillarSpecs`."""

INPUTS = "features", "pillar"
"""(P, F) float32 and (P, 1) int64, see `pillars`; the output is (1, C + 8, H, W) float32, see `boxes_of`."""

MAX_CELLS = 2048

Specs = TypeVar("Specs", bound=SettingsModel)


class FoundClass(SettingsModel):
    """A class that a network finds."""

    name: str  # Its name
    sigma_m: Positive = 0.3  # Standard deviation of its place along x and along y, metres
    sigma_rad: Positive = 0.3  # Standard deviation of its heading, radians
    recorded: bool = False  # Whether its scores were calibrated in recordings, not in simulated worlds alone


class PillarSpecs(SettingsModel):
    """Metadata of a file."""

    classes: Annotated[tuple[FoundClass, ...], Field(min_length=1)]  # Classes of its output, in order
    features: tuple[str, ...] = FEATURES  # Features of its points, in order
    grid: Grid  # Its grid


def specs_in(session: OnnxSession, path: Path, key: str, model: type[Specs], what: str) -> Specs:
    """The metadata of a loaded file under a key, or a ModelError, in which `what` names the expected file."""
    expected = f"{path}: expected {what}"
    if key not in session.metadata:
        raise ModelError(f"{expected}, found none of its metadata ({key}) in the file")
    try:
        return model.model_validate_json(session.metadata[key])
    except ValidationError as err:
        first = err.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ModelError(f"{expected}, found metadata with a fault: {place}: {one_line(first['msg'])}") from err


class PillarNetwork:
    """A loaded network. It gives the same boxes for the same points, whatever their order."""

    def __init__(self, path: Path, session: OnnxSession | None = None) -> None:
        """Load a file, or take it as loaded; raises ModelError if that fails, or it says nothing about its pillars."""
        self._path = path
        self._session = session or OnnxSession(path)
        what = "a 3D network that `lidcam train pillars` wrote"
        specs, expected = specs_in(self._session, path, KEY, PillarSpecs, what), f"{path}: expected {what}"
        if specs.features != FEATURES or specs.grid.cells % 8 or specs.grid.cells > MAX_CELLS:
            raise ModelError(f"{expected} in this version, found other features or another grid: train it anew")
        inputs = [(name, kind) for name, _, kind in self._session.inputs]
        if inputs != [("features", "tensor(float)"), ("pillar", "tensor(int64)")] or len(self._session.outputs) != 1:
            raise ModelError(f"{expected}, found other inputs or outputs")
        self.specs, self.classes, self.cell_m = specs, specs.classes, specs.grid.cell_m

    def reaches(self, xy: F64) -> Bools:
        """(N,) whether places (N, 2) that are relative to the middle are in the grid."""
        return np.asarray((np.abs(xy) < self.specs.grid.half_m).all(1))

    def __call__(self, position: F64, least_log_odds: float) -> Found:
        """The boxes around points.

        Args:
            position: (N, 3) x and y from the middle of the grid, and height above the ground, metres.
            least_log_odds: Boxes with lower log odds are left out.

        Raises:
            ModelError: the network fails.
        """
        grid = self.specs.grid
        features, pillar = pillars(position, grid)
        side = grid.cells // STRIDE
        shape = (1, len(self.specs.classes) + BOX_NUMBERS, side, side)
        if not len(pillar):
            return boxes_of(np.full(shape[1:], -np.inf, np.float32), grid, least_log_odds)
        (output,) = self._session.run(dict(zip(INPUTS, (features, pillar[:, None]), strict=True)), 1)
        if output.shape != shape or output.dtype != np.float32 or not np.isfinite(output).all():
            raise ModelError(f"{self._path}: expected finite numbers {shape}, found {output.dtype} {output.shape}")
        return boxes_of(output[0], grid, least_log_odds)
