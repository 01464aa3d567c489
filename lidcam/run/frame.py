"""A frame as users get it, with drawings."""

from dataclasses import dataclass, fields
from typing import Self

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.text import brief
from lidcam.writers.images.scene import Scene, Scenes
from lidcam.writers.tables.objects import Objects


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frame(FrameResult):
    """All results of one frame, as in `FrameResult`, which can be drawn.

    Attributes:
        objects: The fused objects with their tracks, with the names of classes and zones: a table.
        scene: The content of its images.
        scenes: Draws it.
    """

    objects: Objects
    scene: Scene
    scenes: Scenes

    __repr__ = brief

    @classmethod
    def of(cls, result: FrameResult, scenes: Scenes, rig: Rig, class_names: tuple[str, ...]) -> Self:
        """The next frame of a run."""
        values = {one.name: getattr(result, one.name) for one in fields(FrameResult)}
        objects = Objects.of_frame(result, rig, class_names)
        return cls(**values, objects=objects, scene=scenes.add_frame(result), scenes=scenes)

    def draw(self, camera: str | None = None) -> U8:
        """The frame as an image, (H, W, 3) uint8, red, green, blue.

        Args:
            camera: Name of a camera, for its image with 2D boxes, 3D boxes and matches, as `--save-matches` writes it;
                None: all cameras and the site from above, as in `--video`.

        Raises:
            ConfigError: there is no camera of that name.
        """
        scenes, scene = self.scenes, self.scene
        image, _ = scenes.all_cameras(scene) if camera is None else scenes.camera(scene, camera)
        return image
