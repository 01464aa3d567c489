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
        scene: The content of its images.
        scenes: Draws it.
        rig: The sensors and zones of the run.
        class_names: Name by class id.
    """

    scene: Scene
    scenes: Scenes
    rig: Rig
    class_names: tuple[str, ...]

    __repr__ = brief

    @classmethod
    def of(cls, result: FrameResult, scenes: Scenes, rig: Rig, class_names: tuple[str, ...]) -> Self:
        """The next frame of a run."""
        values = {one.name: getattr(result, one.name) for one in fields(FrameResult)}
        return cls(**values, scene=scenes.add_frame(result), scenes=scenes, rig=rig, class_names=class_names)

    @property
    def objects(self) -> Objects:
        """The fused objects with their tracks and the names of classes and zones, as in `RunResult.objects`."""
        return Objects.of_frame(self, self.rig, self.class_names)

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
