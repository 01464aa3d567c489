"""Engines of the caller: functions that `lidcam.process` is given as `detector` and `detector_2d`."""

import io
import pickle
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lidcam.pipeline.core.arrays import F32, F64, I64, U8, Names
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.detectors.protocols import Candidates2D, Candidates3D


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Found3D:
    """The objects that a `detector` finds in a cloud: N boxes, in any order.

    Attributes:
        centers: (N, 3) float64, x, y, z of the centre of the box (not of its bottom), metres, in the site frame.
        sizes: (N, 3) float64, length, width, height, metres.
        yaws: (N,) float64, direction of the length, radians counter-clockwise about +z; 0 along +x.
        scores: (N,) float64 in [0, 1], probability that there is such an object.
        labels: (N,) str, names of what they are, upper or lower case. Each class has its labels (`classes.N.labels`);
            boxes with others are not used, and counted.
    """

    centers: F64
    sizes: F64
    yaws: F64
    scores: F64
    labels: Names

    __repr__ = brief

    def __init__(
        self, centers: ArrayLike, sizes: ArrayLike, yaws: ArrayLike, scores: ArrayLike, labels: Sequence[str] | Names
    ) -> None:
        """Boxes of lists, or of arrays of any number type, which are copied.

        Raises:
            ValueError: shapes or values are not those of the attributes.
        """
        names = _texts(labels)
        set_field = partial(object.__setattr__, self)
        set_field("labels", names)
        set_field("centers", _numbers("centers", centers, (len(names), 3)))
        set_field("sizes", _numbers("sizes", sizes, (len(names), 3), low=0.0))
        if not (self.sizes > 0).all():
            raise ValueError("sizes: expected more than 0 m, found 0")
        set_field("yaws", _numbers("yaws", yaws, (len(names),)))
        set_field("scores", _numbers("scores", scores, (len(names),), low=0.0, high=1.0))


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Found2D:
    """The objects that a `detector_2d` finds in an image: N boxes, in any order.

    Attributes:
        xyxy: (N, 4) float64, left, top, right, bottom in pixels of the image; (0, 0) is the top left corner of the top
            left pixel.
        scores: (N,) float64 in [0, 1].
        labels: (N,) str, names of what they are, as in `Found3D`.
    """

    xyxy: F64
    scores: F64
    labels: Names

    __repr__ = brief

    def __init__(self, xyxy: ArrayLike, scores: ArrayLike, labels: Sequence[str] | Names) -> None:
        """Boxes of lists, or of arrays of any number type, which are copied.

        Raises:
            ValueError: shapes or values are not those of the attributes.
        """
        names = _texts(labels)
        set_field = partial(object.__setattr__, self)
        set_field("labels", names)
        set_field("xyxy", _numbers("xyxy", xyxy, (len(names), 4)))
        if not (self.xyxy[:, 2:] > self.xyxy[:, :2]).all():
            raise ValueError("xyxy: expected left < right and top < bottom, found a box that is empty or turned over")
        set_field("scores", _numbers("scores", scores, (len(names),), low=0.0, high=1.0))


FindInCloud = Callable[[F32], Found3D]
"""(N, 4) float32: x, y, z in metres in the site frame, and intensity in the lidar's own scale, of all lidars together
at the frame's time, with the ground."""

FindInImage = Callable[[U8], Found2D]
"""(H, W, 3) uint8 RGB, as recorded. A function with an attribute `labels`, the names that it can give, is taken as a
network is: where these are `person` and `bicycle` without a word for riders, a person on a bicycle becomes one."""


class GivenDetectors(NamedTuple):
    """The functions of the caller; None where lidcam's own engines are used."""

    in_cloud: FindInCloud | None = None
    in_images: FindInImage | None = None

    @property
    def names(self) -> dict[str, str]:
        """The modules and names of those that there are, by their keyword of `lidcam.process`."""
        given = {"detector": self.in_cloud, "detector_2d": self.in_images}
        return {key: _name(find) for key, find in given.items() if find is not None}

    @property
    def unsendable(self) -> str:
        """Why other processes cannot have them, in a line; empty if they can."""
        for key, find in (("detector", self.in_cloud), ("detector_2d", self.in_images)):
            try:
                _Elsewhere(io.BytesIO(pickle.dumps(find))).load()
            except Exception:  # whatever pickling a thing of the caller's raises
                return f"{key} {_name(find)} cannot be sent to other processes: define it in a module that they import"
        return ""


LIDCAMS_OWN = GivenDetectors()


class _Elsewhere(pickle.Unpickler):
    """Unpickles as another process does, which has another main program."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        if module_name == "__main__":
            raise pickle.UnpicklingError(global_name)
        return super().find_class(module_name, global_name)


class GivenDetector3D:
    """A `Detector3D` of a function of the caller.

    Attributes:
        unused: Boxes of the last cloud that have labels of no class, by reason.
    """

    def __init__(self, find: FindInCloud, config: Config) -> None:
        self._find, self._class_id_of_label = find, config.class_id_of_label
        self.unused: Counter[str] = Counter()

    def __call__(self, combined: CombinedCloud, /) -> Candidates3D:
        """Proposals for one frame; raises ModelError if the function gives something else."""
        clouds = combined.detection_cloud, combined.ground_cloud
        points = np.concatenate([np.column_stack([cloud.xyz, cloud.intensity]) for cloud in clouds])
        found = _checked(self._find(points), Found3D, "detector", self._find)
        class_ids, self.unused = _class_ids(found.labels, self._class_id_of_label)
        none = np.zeros(len(class_ids), np.int64)
        covariances = np.zeros((len(class_ids), 3, 3))
        return Candidates3D(
            found.centers, found.sizes, found.yaws, found.scores, class_ids, none, covariances, none.copy()
        )


class GivenDetector2D:
    """A `Detector2D` of a function of the caller.

    Attributes:
        labels: Names of the objects that it can find: its own, else all that are configured.
        unused: Boxes of the last images that have labels of no class, by reason.
    """

    def __init__(self, find: FindInImage, config: Config) -> None:
        self._find, self._class_id_of_label = find, config.class_id_of_label
        own = getattr(find, "labels", ())
        own = own.values() if isinstance(own, Mapping) else own  # of names by number, as Ultralytics has them
        self.labels: tuple[str, ...] = (*(tuple(map(str, own)) or self._class_id_of_label), "")
        self._rows = {label.strip().lower(): row for row, label in enumerate(self.labels)}
        self.unused: Counter[str] = Counter()

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        """Proposals for each image; raises ModelError if the function gives something else."""
        self.unused, proposed = Counter(), []
        for image in images:
            found = _checked(self._find(image), Found2D, "detector_2d", self._find)
            self.unused += _class_ids(found.labels, self._class_id_of_label)[1]
            plain = [_plain(label) for label in found.labels]
            others = [one for one in plain if one not in self._rows and one in self._class_id_of_label]
            self.unused += Counter(f"label {one!r} is none of the detector's own" for one in others)
            rows = [self._rows.get(_plain(label), self._rows[""]) for label in found.labels]
            scores = found.scores.astype(np.float32)
            proposed.append(Candidates2D(found.xyxy.astype(np.float32), scores, np.array(rows, np.int64)))
        return proposed


def _plain(label: Any) -> str:
    return str(label).strip().lower()


def _class_ids(labels: Names, class_id_of_label: Mapping[str, int]) -> tuple[I64, Counter[str]]:
    plain = [_plain(label) for label in labels]
    unused = Counter(f"label {label!r} is of no class" for label in plain if label not in class_id_of_label)
    return np.array([class_id_of_label.get(label, -1) for label in plain], np.int64), unused


def _checked(found: Any, kind: Any, keyword: str, find: Any) -> Any:
    if not isinstance(found, kind):
        name = type(found).__name__
        raise ModelError(f"{keyword} {_name(find)}: expected a lidcam.{kind.__name__} from it, found {name}")
    return found


def _name(find: Any) -> str:
    named = find if hasattr(find, "__qualname__") else type(find)
    return f"{named.__module__}.{named.__qualname__}"


def _texts(labels: Sequence[str] | Names) -> Names:
    names = np.array(labels, np.str_)
    if names.ndim != 1:
        raise ValueError(f"labels: expected a name for each box, found an array {[*names.shape]}")
    names.setflags(write=False)
    return names


def _numbers(name: str, values: ArrayLike, shape: tuple[int, ...], low: float = -np.inf, high: float = np.inf) -> F64:
    numbers = np.array(values, np.float64)
    if not numbers.size and not shape[0]:
        numbers = numbers.reshape(shape)
    if numbers.shape != shape:
        raise ValueError(f"{name}: expected {[*shape]} numbers for {shape[0]} labels, found {[*numbers.shape]}")
    if not (np.isfinite(numbers) & (numbers >= low) & (numbers <= high)).all():
        limits = f" in [{low:g}, {high:g}]" if low > -np.inf else ""
        raise ValueError(f"{name}: expected finite numbers{limits}, found {numbers.min():g} to {numbers.max():g}")
    numbers.setflags(write=False)
    return numbers
