"""The fused objects of a run, gathered for notebooks."""

from collections.abc import Callable

from lidcam.pipeline.core.arrays import join_rows
from lidcam.processing import RunObserver
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.tally import RunProgress
from lidcam.writers.tables.objects import Objects


class ObjectCollector(RunObserver):
    """Gathers the objects of a run; memory grows with their number, by about 250 bytes each."""

    def __init__(self, on_frame: Callable[[Frame], None] | None = None, progress: RunObserver | None = None) -> None:
        """Gather objects; `on_frame` is called with each frame, and `progress` looks on, too."""
        self._frames: list[Objects] = []
        self._on_frame = on_frame
        self._progress = progress or RunObserver()

    def opened(self, source: RunInput) -> None:
        """Take over the sensors, with the zones, and the names of the classes."""
        self._rig, self._class_names = source.rig, source.config.object_names
        self._frames = [Objects.empty(source.rig, source.config.object_names)]
        self._progress.opened(source)

    def frame(self, result: Frame) -> None:
        """Take over the objects of one frame."""
        self._frames.append(Objects.of_frame(result, self._rig, self._class_names))
        if self._on_frame is not None:
            self._on_frame(result)

    def advanced(self, progress: RunProgress) -> None:
        """Pass on how far the run is."""
        self._progress.advanced(progress)

    @property
    def objects(self) -> Objects:
        """The objects of the frames so far; the recording has to be open, or to have been."""
        return join_rows(*self._frames)
