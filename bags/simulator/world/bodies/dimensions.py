"""Dimensions of the moving shapes: boxes, wheels, steering."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Shape:
    """Dimensions of a shape in its base frame (x forward, y left, z up).

    The base frame lies on the ground: below the middle of the rear axle, the rear wheel of a cyclist, the middle of a
    pedestrian.
    """

    class_name: str  # ground truth class
    size_m: Vector  # length, width, height of what it needs: mirrors and a walker's whole stride included
    box_center_m: Vector  # centre of that box, and of the body's
    body_width_m: float | None = None  # width of a motor vehicle without mirrors; None for people
    wheel_base_m: float = 0.0  # from axle to axle; 0 for a pedestrian
    track_width_m: float = 0.0  # between the centres of the front wheels; 0 without two of them
    wheel_radius_m: float = 0.0  # radius of all wheels; 0 for a pedestrian
    max_steering_rad: float = 0.0  # limit at the middle of the front axle; the inner wheel turns further

    @property
    def body_size_m(self) -> Vector:
        """Length, width, height without mirrors."""
        length, width, height = self.size_m
        return length, width if self.body_width_m is None else self.body_width_m, height

    @property
    def rear_m(self) -> float:
        """The x of the rear end of the box; negative."""
        return self.box_center_m[0] - self.size_m[0] / 2

    @property
    def front_m(self) -> float:
        """The x of the front end of the box."""
        return self.box_center_m[0] + self.size_m[0] / 2

    @property
    def bottom_m(self) -> float:
        """The z of the bottom of the box."""
        return self.box_center_m[2] - self.size_m[2] / 2


SHAPES: Mapping[str, Shape] = {
    # 1:14, as in the predecessor system: the box starts 7 mm above the table, controllers turn 28 rad per metre.
    "model_car": Shape("car", (0.33, 0.22, 0.21), (0.105, 0.0, 0.112), 0.206, 0.21, 0.165, 1 / 28, 0.6),
    "car": Shape("car", (4.50, 1.92, 1.48), (1.30, 0.0, 0.74), 1.80, 2.70, 1.44, 0.31, 0.48),
    "van": Shape("van", (5.90, 2.34, 2.50), (1.85, 0.0, 1.25), 2.02, 3.60, 1.64, 0.34, 0.50),
    "truck": Shape("truck", (8.60, 2.78, 3.50), (2.10, 0.0, 1.75), 2.54, 4.80, 1.98, 0.48, 0.50),
    "bus": Shape("bus", (12.0, 2.88, 3.10), (2.60, 0.0, 1.55), 2.58, 5.90, 2.04, 0.48, 0.55),
    "cyclist": Shape("cyclist", (1.73, 0.58, 1.72), (0.525, 0.0, 0.86), None, 1.05, 0.0, 0.34, 0.7),
    "pedestrian": Shape("pedestrian", (0.96, 0.54, 1.78), (-0.03, 0.0, 0.89)),
}
"""By the `shape` of a vehicle in a scenario."""


def shape_of(name: str, scale: Vector) -> Shape:
    """A shape by name, its length, width and height times a scale."""
    shape, (x, y, z) = SHAPES[name], scale
    return replace(
        shape,
        size_m=(x * shape.size_m[0], y * shape.size_m[1], z * shape.size_m[2]),
        box_center_m=(x * shape.box_center_m[0], y * shape.box_center_m[1], z * shape.box_center_m[2]),
        body_width_m=None if shape.body_width_m is None else y * shape.body_width_m,
        wheel_base_m=x * shape.wheel_base_m,
        track_width_m=y * shape.track_width_m,
        wheel_radius_m=z * shape.wheel_radius_m,
    )
