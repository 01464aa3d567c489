"""Settings of detection in clouds and in images."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BeforeValidator

from lidcam.pipeline.core.settings.engines import ENGINES
from lidcam.pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel, Share

if TYPE_CHECKING:
    Method3D = str
else:
    Method3D = Literal[("auto", *ENGINES)]

NetworkLayout = Literal["yolox", "yolov5", "yolov8", "end_to_end", "rtdetr", "detr", "dfine"]
NetworkColors = Literal["bgr_255", "rgb_255", "bgr_1", "rgb_1", "imagenet"]
Provider = Literal["auto", "cpu", "cuda", "tensorrt", "openvino", "migraphx", "directml", "coreml"]


class ClusterConfig(SettingsModel):
    """Detection by clustering of points.

    Attributes:
        distance_m: Points nearer to each other than this belong together, close to a lidar.
        distance_per_m: Growth of that distance per metre of range, because points thin out.
        clearance_m: Points lower than this above the ground are ignored: kerbs and remains of the ground would join
            objects.
        min_points: A cluster of fewer points is noise.
        min_height_m: A cluster whose top is lower than this above the ground is a kerb or noise.
        max_bottom_m: A cluster whose lowest point is higher than this above the ground hangs there, unless something
            nearer to the lidar hides what is below it.
        points_per_sr: Beams of one lidar per steradian: 1 / (vertical x horizontal resolution in radians). Gives the
            number of points to expect from an object in full view, which its score depends on.
    """

    distance_m: Positive = 0.4
    distance_per_m: NotNegative = 0.01
    clearance_m: NotNegative = 0.3
    min_points: Count = 10
    min_height_m: NotNegative = 0.5
    max_bottom_m: Positive = 1.0
    points_per_sr: Positive = 45_000.0


class Recorded3DConfig(SettingsModel):
    """3D boxes that a detector wrote into the recording.

    Attributes:
        class_numbers: Meaning of a number in the place of a class name in vision_msgs: with `labels` the class that has
            it among its labels, with `coco` a row of the 80 names of COCO, from 0, with `autoware` Autoware's numbers
            (1 car, 2 truck, 3 bus, 4 trailer, 5 motorcycle, 6 bicycle, 7 pedestrian). A name is looked up in the labels
            either way. Autoware's own messages have its numbers.
    """

    class_numbers: Literal["labels", "coco", "autoware"] = "labels"


class Detect3DConfig(SettingsModel):
    """3D boxes of the lidars.

    Attributes:
        method: `cluster` finds them in the combined cloud and needs no weights; `pillars` runs the network of `model`;
            `combined` does both and joins what they find, by the network and, of classes that it knows, the learned
            score of clusters, whatever `score` is; `recorded` takes those that a detector wrote into the recording
            (`topics.boxes3d`); `callable` calls the function that `lidcam.process` gets as `detector`; `none` finds
            nothing. `auto` is `combined` where all classes are road users of full size or a model is set (as in the
            preset sandbox), else `cluster`; with a `score`, and without a model, it is `cluster`.
        model: ONNX file of `lidcam train pillars`, relative to the working folder, or the name of one that comes with
            lidcam: `traffic` for road users of full size, their default; `sandbox` for model cars.
        score: How boxes of the method `cluster` are scored. `geometric`: by the number of their points, the smoothness
            of their sides and the fit to the size of their class. `learned`: by a small network, trained on simulated
            roads, that also chooses the class; its score is a probability. It knows cars, pedestrians, bicycles, trucks
            and buses of full size. `auto`: `learned` where the lidars decide alone, for want of 2D boxes, and all
            classes are of these, or where `weights` are named; else `geometric`.
        weights: File of that network, as `lidcam train clusters` writes it. Empty: the one that comes with lidcam.
        min_score: Boxes with a lower score are removed; with `learned`, those whose geometric score is lower; with
            `combined` clusters of a lower geometric score, and then boxes that are less probable.
        near_weight: Log odds that `combined` adds to a truck or bus that the network finds, too, for each logarithm of
            its points, where its side is at a lidar, less up to 6 m. Beside lidars on a vehicle there is traffic; 0 for
            fixed ones, beside walls.
        provider: Library that runs the network of `model`, as `detect2d.provider`.
        cluster: Settings of the method `cluster`.
        recorded: Settings of the method `recorded`.
    """

    method: Method3D = "auto"
    model: Path | None = None
    score: Literal["auto", "learned", "geometric"] = "auto"
    weights: Path | None = None
    min_score: Share = 0.07
    near_weight: NotNegative = 0.4
    provider: Provider = "cpu"
    cluster: ClusterConfig = ClusterConfig()
    recorded: Recorded3DConfig = Recorded3DConfig()

    @property
    def engine(self) -> str:
        """The row of `ENGINES` that `method` means; `auto` without a model has to be decided before."""
        return self.method if self.method != "auto" else "combined" if self.model else "cluster"

    @property
    def is_learned(self) -> bool:
        """Whether a network scores clusters; `auto` of `score` has to be decided before."""
        return self.engine == "cluster" and self.score == "learned"

    @property
    def has_network(self) -> bool:
        """Whether a 3D network finds boxes."""
        return self.engine in {"pillars", "combined"}

    @property
    def scores_are_probabilities(self) -> bool:
        """Whether a score is the probability that there is an object; other scores are calibrated by the belief."""
        return self.is_learned or ENGINES[self.engine].scores_are_probabilities


class Detect2DConfig(SettingsModel):
    """Detection in images.

    Attributes:
        method: `onnx` runs a network, `recorded` takes 2D boxes from the recording, `callable` calls the function that
            `lidcam.process` gets as `detector_2d`, `none` finds nothing. `auto` is `onnx` if a model is given, else
            `recorded` if there are boxes, else `onnx` if `model` finds one, else `none`.
        model: ONNX file, relative to the working folder, or the name of a network that `lidcam fetch` brought;
            docs/networks.md lists the exports that are known. `auto`: the most precise network that was fetched,
            where the recording has images and no 2D boxes. `none`: no network.
        layout: Layout of the network's outputs. `auto`: recognised by their shapes. `yolox`; `yolov5` (also YOLOv6,
            YOLOv7); `yolov8` (also YOLO11); `end_to_end`: with suppression inside (also YOLOv10, YOLO26); `rtdetr`: of
            Ultralytics; `detr`: boxes and scores (RT-DETR, D-FINE, RF-DETR); `dfine`: labels, boxes and scores.
        colors: Order of the channels that the network is given, and the value of white, 255 or 1; `imagenet`: red
            first, less ImageNet's mean, by its deviation. `auto`: as its layout has it.
        names: Names of the network's classes: `coco` (80), `coco91` (by the numbers of the annotations), or a file
            with a name in each line, or YAML or JSON with `names`. Empty: as in the network's file, else COCO's if
            there are 80.
        provider: Library that runs the network. Only `cpu` gives the same result on every machine; `cuda` needs a
            plug-in of onnxruntime, the others another build of it. `auto`: `cuda` where a device can be used, else
            `cpu`.
        input: Width and height of the images that the network is given, pixels. `auto`: the shape of the camera's
            own image, as large as `max_input_px` allows and never larger than the image; overlapping tiles of the
            size that the network is made for, if it takes no other.
        max_input_px: Pixels of the images that the network is given, at most, where `input` is `auto`; as many again
            for the part of a larger image where people are too far away to be found. The time that a network takes
            grows with them, and so does the distance at which it finds things.
        min_score: Boxes with a lower score are removed. Low, because what a 2D box is worth is decided together with
            the lidars.
        class_numbers: Meaning of a number in the place of a class name in recorded boxes: with `labels` the class that
            has it among its labels, with `coco` a row of the 80 names of COCO, from 0 (0 person, 2 car). A name is
            looked up in the labels either way.
    """

    method: Literal["auto", "onnx", "recorded", "callable", "none"] = "auto"
    model: Annotated[Literal["auto"] | Path | None, BeforeValidator(lambda v: None if v == "none" else v)] = "auto"
    layout: Literal["auto"] | NetworkLayout = "auto"
    colors: Literal["auto"] | NetworkColors = "auto"
    names: str = ""
    provider: Provider = "cpu"
    input: Literal["auto"] | tuple[Count, Count] = "auto"
    max_input_px: Count = 1_000_000
    min_score: Share = 0.15
    class_numbers: Literal["labels", "coco"] = "labels"
