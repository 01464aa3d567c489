from typing import Any, Final

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, U8, Bools, Indices

# assignment.cpp

def columns_of_rows(costs: F64) -> Indices:
    """(R,) the column of each row of costs (R, C), R <= C."""

# neighbors.cpp

def mean_neighbor_distance_m(xyz: F32, neighbors: int) -> F32:
    """(N,) mean distance of finite points (N, 3) to 1 to N - 1 nearest neighbours, other than itself, as PCL rounds it.

    Squares of distances, their sums and roots in float32, the sum over the neighbours, nearest first, in float64.
    """

# motion.cpp

def moved(xyz: F32, matrix: F32) -> F32:
    """Points (N, 3) moved by a matrix (3, 4)."""

def moved_each(xyz: F32, since_ns: I64, matrices: F32, step_ns: int) -> F32:
    """Points (N, 3), each moved by the matrix of its time.

    `since_ns` (N,) is the time since the first of the matrices (K, 3, 4), of which there is one each `step_ns` and one
    beyond the last point; between two of them, their numbers are interpolated.
    """

# ground.cpp: `lidcam.pipeline.filters.ground`

def count_layers(points: F32, planes: F32, layer_m: float) -> tuple[I64, I64]:
    """(K,) number of points (3, N) within a layer of each plane (K, 4), and in the fuller of the two beside it.

    A layer reaches `layer_m` to both sides of a plane; those above and below it are as thick.
    """

def scatter_within(points: F32, plane: F32, limit_m: float) -> tuple[F64, F64]:
    """Centre (3,) and covariance (3, 3) of the points (3, N) at most `limit_m` from a plane (4,); zeros of none."""

def scatter_near(points: F32, plane: F32, layer_m: float) -> tuple[int, F64, F64]:
    """How many points (3, N) are in the layer of a plane (4,); centre (3,) and covariance (3, 3) of those near it.

    Near means within `layer_m`, and within three times the robust deviation of those points: wheels and kerbs lie on
    one side and would lift a plane. Without a point in the layer, both are zero.
    """

def parted(
    xyz: F32, kept: Bools, plane: F32, distance_m: float, origin_xy: F64, cell_m: float, offsets_m: F64
) -> tuple[I64, I64, I64]:
    """Rows of the points that are kept and not on a plane, that are kept and on it, and that are not on the ground.

    On it is what is at most `distance_m` from the plane (4,), or from the ground, which differs from that by `Relief`.
    """

# relief.cpp: `lidcam.pipeline.filters.relief`

def lowest_heights(
    points: F32,
    plane: F32,
    middle: F32,
    origin: F32,
    cell_m: float,
    side: int,
    reach_m: float,
    slope: float,
    layer_m: float,
) -> tuple[I64, F64, F64]:
    """(M,) the cells of a grid that hold points near a plane, and (M,) the mean height of the lowest of them above it.

    The last value (M,) is how much higher the highest of them is. Cells are counted from `origin` (2,) on, along x
    first, `side` of them along each axis, at most 46340. Points (3, N) are near up to `reach_m` from the plane
    (4,), and `slope` more for each metre from the `middle` (2,) of the lidars. The mean is that of points up to
    `layer_m` above the lowest of their cell.
    """

def grown_surface(
    xy: F64,
    heights_m: F64,
    standing_weights: F64,
    side: int,
    taps: F64,
    counts: I64,
    near_m: F64,
    standing_m: float,
    max_weight: float,
    prior_weight: float,
    fill_weight: float,
) -> F64:
    """(side, side) a surface that grows from zero towards heights; where there are none, it goes on as it is nearby.

    The heights (M,) are at `xy` (M, 2), in nodes. `taps` holds half a kernel of the smoothing of each round, from
    its middle on, one after another, then that of the filling, and that of the borders of what is known; `counts`
    (rounds + 2,) are their lengths. In a round, heights at most `near_m` (rounds,) from the surface pull it; those
    farther above it than `standing_m` with their `standing_weights` (M,) instead of 1. The weights of a node sum up
    to `max_weight` at most; the last surface has `prior_weight`, and zero, where nothing is known, `fill_weight`.
    """

# clusters

def cells_of_points(
    points: F64, distance_m: F64, share: float, edges_m: F64, group: I64, groups: int
) -> tuple[F64, F64, I64, I64, I64]:
    """The fields of `Cells` for at least one point (N, 3), see `thin_points`.

    The edge of a cell is the longest of `edges_m`, a rising series, that is no longer than the share of the distance.
    `group` is below `groups`.
    """

def linked_parts(points: F64, distance_m: F64, series: F64) -> tuple[int, I64]:
    """Number of the connected parts of the graph of points at most the smaller of their distances apart, and (N,) them.

    Points (N, 3) are numbered by their parts, in order of the first point of each. Those of a level of distances, steps
    of a rising series, lie in a square grid of their own, so that far points with their wide search do not look at many
    near ones.
    """

# lshape: points (N, 2 or more) are sorted by cluster, and `ends` (C,) are the rows behind the last ones of clusters

def closest_directions(xy: F64, ends: I64, low: F64, diagonal_m: F64, cos: F64, sin: F64, coarse: int) -> I64:
    """(C,) the direction in which the points of each cluster are closest to the sides of their bounding rectangle.

    The best one of the coarse directions, then of the fine ones about that, which follow all coarse ones in `cos` and
    `sin`; of those alike the first. Clusters are thinned before, from their lowest x and y `low` (C, 2) on, in cells
    that are a share of their diagonals.
    """

def quantiles(values: F64, ends: I64, share: float) -> F64:
    """(C,) see `quantiles_by_cluster`."""

def rectangles(xy: F64, ends: I64, cos: F64, sin: F64, outside_share: float) -> tuple[F64, F64, F64]:
    """Lower and upper ends of the rectangle around each cluster along its axes, (C, 2); and its residual (C,)."""

# boxes

def points_above_ground(
    xyz: F32,
    lidar_index: U8,
    time_ns: I32,
    rows: I64,
    plane: F64,
    relief_m: F64,
    grid: F64,
    lidar_xyz: F64,
    distance_m: float,
    distance_per_m: float,
    above_m: float,
    below_m: float,
) -> tuple[I64, F64, I64, F64, F64]:
    """The fields of `AboveGround` of the points (N, 3) in `rows` between two heights above the ground, both excluded.

    The ground is `plane` (4,), normal and offset, and above it `relief_m` (H, W) at the nodes of a grid, rows along y;
    `grid` (3,) is x and y of the first node, and the distance of nodes, metres. The link distance is `distance_m`, and
    `distance_per_m` more for each metre from the lidar (L, 3).
    """

def completed_boxes(
    low: F64,
    high: F64,
    angle_rad: F64,
    cos: F64,
    sin: F64,
    top_m: F64,
    gap_m: F64,
    lidar_share: F64,
    lidar_xy: F64,
    class_ids: I64,
    mean_m: F64,
    limit_m: F64,
    rarity: F64,
    given_ids: I64,
    axis_costs: F64,
    max_slender_share: float,
) -> tuple[I64, F64, F64, F64, F64, F64, F64, Bools]:
    """The fields of `CompletedBoxes`, see `complete_boxes`; `given_ids` are -1 where the class is to be chosen."""

def box_shapes(position: F64, starts: I64, placed: F64, heading: F64, sight: F64, reach_m: float) -> tuple[F64, F64]:
    """Numbers (B, 7) and shapes (B, 26) of the points in and around each box, see `box_features`.

    `placed` (B, 5) are x and y of the centre and the size of each box, `heading` (B, 2) the direction of its length,
    `sight` (B, 2) that of the nearest lidar in its frame. The numbers are those of points inside, at the ends, at the
    sides, nearer, farther, high beside and above. The shapes are the columns of `FEATURES` from `low` on, zeros for
    fewer than three points.
    """

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

def nearest_in_cells(matrices: F32, low: F32, cell: F32, xyz: F32, rows: int, columns: int, near_m: float) -> F32:
    """(C, rows, columns) range of the nearest of the points (P, 3) in each cell of a camera's view, metres, or inf.

    `matrices` (C, 4, 4) lead from the frame of the points to the cameras. `low` (C, 2) are low ends of the views across
    and down, `cell` (C, 2) width and height of a cell, in the plane one metre ahead. Nearer points than `near_m` count
    for nothing.
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
    """The leftmost, topmost, rightmost and bottommost point of each object, see `project_edges`.

    After the cosines and sines of the yaws come the fields of `Outline`, `CameraArrays` and, from `K` on, `Lenses`.
    The third output, (Q, 4), is which point of the outline each is, of those alike the first.
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
