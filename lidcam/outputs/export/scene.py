"""A result as a scene of a data set: its objects, the truth, clouds and images, frame by frame."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from lidcam.notebook.loaded import load_result
from lidcam.outputs.export.frames import ExportOptions, ResultFrames
from lidcam.pipeline.core.arrays import F64, I32, join_rows
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, TruthBoxes3D
from lidcam.pipeline.evaluation.ignoring import is_evaluated
from lidcam.pipeline.evaluation.vans import VAN
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.results.result import Result
from lidcam.writers.datasets.frame import (
    DatasetBoxes,
    DatasetFrame,
    DatasetImage,
    DatasetScene,
    DatasetWriter,
    undistorted,
)
from lidcam.writers.tables.objects import Objects

CLOUD, GROUND = "/point_cloud_combined", "/ground_cloud"


class ResultScene(ResultFrames):
    """A result, frame by frame as a data set has it.

    Attributes:
        facts: What all frames have in common.

    Raises:
        LidcamError: the format needs clouds, and the result has none; or the truth cannot be read.
    """

    def __init__(
        self, result: Result, format_name: str, writer: DatasetWriter, options: ExportOptions, stack: ExitStack
    ) -> None:
        super().__init__(result, options, writer.left_out, stack)
        self._writer, self._format = writer, format_name
        if CLOUD not in self.recorded:
            raise RecordingError(
                f"{result.path}: {format_name} needs clouds ({CLOUD}), found none: process the recording again with "
                "output.clouds=true"
            )
        self._objects = load_result(result.path)[1]
        self._unit: float | None = None
        self._names = _names(result.config, writer.names)
        lidars = result.rig.lidars
        only = lidars[0].T_site_lidar if len(lidars) == 1 else None
        self._T_cloud_site = np.eye(4) if only is None else only.inverse().matrix
        self.facts = DatasetScene(
            name=result.path.stem,
            origin=f"{result.path.stem} {sorted(result.metadata.items())}",
            rig=result.rig,
            cameras=tuple(camera for camera in result.rig.cameras if camera in self.images.values()),
            T_site_cloud=np.eye(4) if only is None else only.matrix,
            cloud_frame_id=result.rig.site_frame if only is None else only.src,
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the result for the user."""
        if not (self._result.is_adrift and self._format == "nuscenes"):
            return super().notes
        name = self._result.path.name
        adrift = f"{name}: the sensors move, and the result does not say where to: nuScenes's poses stand still"
        return (*super().notes, adrift)

    def frames(self) -> Iterator[DatasetFrame]:
        """Every Nth frame."""
        for found, messages in self.frames_and_messages([CLOUD, GROUND, *self.images]):
            yield self._frame(found, messages)

    def _frame(self, found: EvaluationFrame, messages: Mapping[str, RawMessage]) -> DatasetFrame:
        first, end = np.searchsorted(self._objects.frames, [found.index, found.index + 1])
        objects = self._objects[int(first) : int(end)]
        if self._options.confirmed:
            objects = objects.select(objects.matched > 0)
        return DatasetFrame(
            index=found.index,
            stamp_ns=found.stamp_ns,
            T_fixed_site=found.T_fixed_site,
            cloud=self._cloud(messages),
            images=self._decoded(messages),
            objects=self._named(_boxes(objects, self._names[objects.class_ids]), objects.class_ids, "objects"),
            truth=None if found.truth is None else self._true_boxes(found.truth),
        )

    def _cloud(self, messages: Mapping[str, RawMessage]) -> PointCloud | None:
        limits = self._result.config.limits
        parts = [decode_pointcloud2(messages[topic], limits=limits) for topic in (CLOUD, GROUND) if topic in messages]
        if not parts:
            return None
        cloud = join_rows(*parts)
        if self._unit is None and len(cloud):
            self._unit = 255.0 if cloud.intensity.max() > 1 else 1.0
        T = self._T_cloud_site
        xyz = np.asarray(cloud.xyz @ T[:3, :3].T + T[:3, 3], np.float32)
        intensity = np.clip(cloud.intensity / (self._unit or 1.0), 0, 1).astype(np.float32)
        return replace(cloud, frame_id=self.facts.cloud_frame_id, xyz=xyz, intensity=intensity)

    def _decoded(self, messages: Mapping[str, RawMessage]) -> dict[str, DatasetImage]:
        images = {}
        for topic, camera in self.images.items():
            if topic not in messages:
                continue
            if (rgb := self.pixels_of(messages[topic], camera)) is None:
                continue
            stamp_ns = messages[topic].stamp_ns
            pose = self._poses.T_fixed_site(stamp_ns)
            fixed: F64 | None = None if pose is None else pose.matrix
            images[camera.name] = DatasetImage(stamp_ns, undistorted(rgb, camera.model), fixed)
        return images

    def _true_boxes(self, truth: TruthBoxes3D) -> DatasetBoxes:
        is_none = truth.class_ids == UNKNOWN
        self.count("true objects of no class of the settings", is_none)
        truth = truth.select(~is_none)
        is_wanted = is_evaluated(truth, self._result.config.evaluate)
        self.count("true objects that no sensor sees, or that are not evaluated", ~is_wanted)
        truth = truth.select(is_wanted)
        n = len(truth)
        is_van = (np.char.lower(truth.labels) == VAN) & (VAN in self._writer.names)
        boxes = DatasetBoxes(
            np.where(is_van, self._writer.names.get(VAN, ""), self._names[truth.class_ids]),
            truth.centers,
            truth.sizes,
            truth.yaws,
            np.ones(n, np.float32),
            truth.track_ids,
            np.full((n, 2), np.nan),
            truth.lidar_points,
        )
        return self._named(boxes, truth.class_ids, "true objects")

    def _named(self, boxes: DatasetBoxes, class_ids: I32, what: str) -> DatasetBoxes:
        """The boxes that have a name of the format; those of a class that it has not are left out."""
        is_known = boxes.names != ""
        for class_id in np.unique(class_ids[~is_known]):
            name = self._result.config.object_names[class_id]
            self.count(f"{what} of class {name}, which {self._format} does not have", class_ids == class_id)
        return boxes.select(is_known)


def _boxes(objects: Objects, names: npt.NDArray[np.str_]) -> DatasetBoxes:
    return DatasetBoxes(
        names,
        objects.centers,
        objects.sizes,
        objects.yaws,
        objects.scores,
        np.where(objects.tracks == NO_TRACK, -1, objects.tracks),
        objects.velocities,
        objects.point_counts,
    )


def _names(config: Config, known: Mapping[str, str]) -> npt.NDArray[np.str_]:
    """(N,) str, the format's name of each class of objects, by the class's name or its other names; empty without.

    A format that has no names of its own takes those of the settings.
    """
    if not known:
        return np.array(config.object_names, np.str_)
    labels = {prior.name: (prior.name, *prior.labels) for prior in config.classes}
    words = [[word.lower() for word in labels.get(name, (name,))] for name in config.object_names]
    return np.array([next((known[word] for word in one if word in known), "") for one in words], np.str_)
