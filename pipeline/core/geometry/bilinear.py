"""Values between the nodes of a grid: a part of compiled functions (`Relief.offset_m` does it for arrays)."""

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.compiled import inlined


@inlined
def between(values: F64, x: float, y: float) -> float:
    """Bilinear at a place in nodes of a grid (rows along y, columns along x); beyond the grid that of its edge."""
    height, width = values.shape
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    column, row = min(int(x), width - 2), min(int(y), height - 2)
    x, y = x - column, y - row
    near = values[row, column] * (1 - x) + values[row, column + 1] * x
    far = values[row + 1, column] * (1 - x) + values[row + 1, column + 1] * x
    return float(near * (1 - y) + far * y)
