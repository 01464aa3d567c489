"""Classes of road users, with their sizes."""

from pydantic import model_validator

from lidcam.pipeline.core.settings.model import Positive, SettingsModel

MIN_UPRIGHT_HEIGHT = 2.0
"""Minimum ratio of height to the smaller of length and width of a person."""


class ClassPrior(SettingsModel):
    """A class of road users, and what is known of its size.

    Attributes:
        name: Class name in the results.
        size_m: Typical length, width, height, metres.
        max_size_m: Largest length, width, height; a larger box is not of this class.
        kinds_m: Typical length, width, height of other kinds of the class that are far from `size_m`, as vans and
            semi-trailers are among trucks. Their largest size is in proportion to it as `max_size_m` is to `size_m`.
        frequency: How common the class is, relative to the others; decides between classes that fit equally well.
        labels: Names that detectors use for it, in small or capital letters: by default those of COCO, KITTI and
            nuScenes, but for what is of no class, as KITTI's Tram and Misc. Also numbers, for recorded boxes that have
            numbers in place of names (vision_msgs of ROS 1). By default the numbers are those of the predecessor
            system, 1 car, 2 pedestrian, 3 bicycle, and of the simulator, 4 van, 5 truck, 6 bus; see
            `detect2d.class_numbers`.
    """

    name: str
    size_m: tuple[Positive, Positive, Positive]
    max_size_m: tuple[Positive, Positive, Positive]
    kinds_m: tuple[tuple[Positive, Positive, Positive], ...] = ()
    frequency: Positive = 1.0
    labels: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _largest_is_largest(self) -> "ClassPrior":
        if any(largest < size for largest, size in zip(self.max_size_m, self.size_m, strict=True)):
            raise ValueError(f"max_size_m: expected no less than size_m, {self.size_m}, found {self.max_size_m}")
        return self

    @property
    def is_upright(self) -> bool:
        """Whether it is a person, on foot or riding: much higher than wide."""
        return self.size_m[2] > MIN_UPRIGHT_HEIGHT * min(self.size_m[:2])

    @property
    def known_as(self) -> tuple[str, ...]:
        """Name and labels as they are looked up: in small letters, without space around them."""
        return tuple(name.strip().lower() for name in (self.name, *self.labels))


# fmt: off
ROAD_CLASSES = (
    ClassPrior(
        name="car",
        size_m=(4.0, 1.7, 1.55),
        max_size_m=(5.6, 2.4, 2.3),
        labels=("car", "1", "vehicle.car", "vehicle.emergency.police"),
    ),
    ClassPrior(
        name="pedestrian",
        size_m=(0.7, 0.7, 1.75),
        max_size_m=(1.2, 1.2, 2.1),
        frequency=0.5,
        labels=(
            "person", "pedestrian", "2", "person_sitting", "human.pedestrian.adult", "human.pedestrian.child",
            "human.pedestrian.construction_worker", "human.pedestrian.police_officer",
            "human.pedestrian.personal_mobility", "human.pedestrian.stroller", "human.pedestrian.wheelchair",
        ),
    ),
    ClassPrior(
        name="bicycle",
        size_m=(1.8, 0.6, 1.7),
        max_size_m=(2.3, 1.1, 2.1),
        frequency=0.2,
        labels=(
            "bicycle", "motorcycle", "cyclist", "3", "rider", "bicyclist", "motorcyclist", "bike", "motorbike",
            "vehicle.bicycle", "vehicle.motorcycle",
        ),
    ),
    ClassPrior(
        name="truck",
        size_m=(8.0, 2.5, 3.2),
        max_size_m=(16.0, 3.2, 4.2),
        kinds_m=((5.5, 2.0, 2.4), (13.5, 2.5, 3.2)),
        frequency=0.2,
        labels=(
            "truck", "van", "4", "5", "trailer", "construction_vehicle", "vehicle.truck", "vehicle.trailer",
            "vehicle.construction", "vehicle.emergency.ambulance",
        ),
    ),
    ClassPrior(
        name="bus",
        size_m=(11.5, 2.55, 3.2),
        max_size_m=(18.5, 3.2, 4.2),
        frequency=0.2,
        labels=("bus", "6", "vehicle.bus.rigid", "vehicle.bus.bendy"),
    ),
)
# fmt: on
