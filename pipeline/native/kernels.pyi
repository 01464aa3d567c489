from typing import Any, Final

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, Indices

ONE: Final[int]
SEQUENCE: Final[int]
"""Lengths of fields with one value, and of those with a sequence; others are arrays of this length."""

class CdrType:
    """A type of messages, for `cdr`."""

    def __init__(self, name: str, fields: list[tuple[str, str | CdrType, int]]) -> None:
        """Take the attributes of its messages in order, each with what it holds and its length.

        It holds messages, texts ("string"), or numbers: "bool", "byte", "char", "int8", "uint8" and so on, "float32",
        "float64".

        Raises:
            ValueError: it holds something else.
        """

def cdr(type: CdrType, message: Any) -> bytes:
    """A message as little-endian CDR.

    Sequences and arrays of numbers are numpy arrays of their type, others are lists.

    Raises:
        ValueError: a number does not fit its field, or an array has another length.
        TypeError: a field holds something else.
    """

def columns_of_rows(costs: F64) -> Indices:
    """(R,) the column of each row of costs (R, C), R <= C."""

def nearest_in_cells(matrices: F32, low: F32, cell: F32, xyz: F32, rows: int, columns: int, near_m: float) -> F32:
    """(C, rows, columns) range of the nearest of the points (P, 3) in each cell of a camera's view, metres, or inf.

    Args:
        matrices: (C, 4, 4) from the frame of the points to the cameras.
        low: (C, 2) low ends of the views across and down, in the plane one metre ahead.
        cell: (C, 2) width and height of a cell there.
        xyz: (P, 3) metres.
        rows: Number of cells down.
        columns: Number of cells across.
        near_m: Points at this depth or nearer count for nothing.
    """

def outermost_points(
    centers: F64,
    sizes: F64,
    cosines: F64,
    sines: F64,
    rows: Indices,
    signs: F64,
    offsets: F64,
    rotations: F64,
    translations: F64,
    K: F64,
    coefficients: F64,
    equidistant: Bools,
    limits: F64,
) -> tuple[F64, F64, Indices, Bools]:
    """The leftmost, topmost, rightmost and bottommost point of each object in the image of its camera.

    Points of an object are at `signs * size / 2 + offsets` along the axes of its box.

    Args:
        centers: (Q, 3) centres of boxes in the site frame, metres.
        sizes: (Q, 3) length, width, height, metres.
        cosines: (Q,) of the yaws.
        sines: (Q,) of the yaws.
        rows: (Q,) camera and outline of each box, of P of both.
        signs: (S, 3), the same for all; S is at least 1.
        offsets: (P, S, 3) metres, or (1, S, 3) if they are the same for all.
        rotations: (P, 3, 3) site to camera.
        translations: (P, 3) metres.
        K: (P, 3, 3), and so on: the fields of `Lenses`.
        coefficients: (P, 8).
        equidistant: (P,).
        limits: (P,).

    Returns:
        (Q, 4) u, v, u, v of these points, pixels; (Q, 4, 7) their derivatives by x, y, yaw, length, width, height, z of
        the box; (Q, 4) which of the S points they are, of those alike the first; (Q,) whether all points of the object
        are ahead and within the lens model.
    """

def pillar_features(
    position: F64, cell_m: float, cells: int, low_m: float, high_m: float, step_m: float
) -> tuple[F32, I64, I64, F64]:
    """The features that need no logarithm and no root, see `detectors.pillars.grid.pillars`, of points (N, 3).

    Returns:
        (P, 8) float32 features, of which the last two are zero; (P,) the pillar of each of these points; (P,) the
        number of points in it; (P, 2) x and y in steps of `step_m`, metres.
    """

def pixels_of_points(points: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> tuple[F64, Bools]:
    """See `Lenses.project`; the arguments after the first are the fields of `Lenses`."""

def points_in_regions(xyz: F32, planes: F64) -> tuple[I64, I64]:
    """See `core.geometry.regions.points_in_regions`."""

def rays_of_pixels(pixels: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> tuple[F64, Bools]:
    """See `Lenses.rays_of_pixels`; the arguments after the first are the fields of `Lenses`."""
