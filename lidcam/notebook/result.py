"""Runs and inspections in notebooks: tables, a plot of the tracks, a viewer."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any, Self

import numpy as np

from lidcam.inspection import Inspection
from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.processing import RunObserver
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.summary import DropCount, RunSummary
from lidcam.run.tally import RunProgress
from lidcam.writers.palette import class_color
from lidcam.writers.tables.objects import Objects


class ShownInspection(Inspection):
    """An inspection that a notebook shows as `lidcam inspect` prints it."""

    __slots__ = ()

    @classmethod
    def of(cls, found: Inspection) -> Self:
        """The same inspection."""
        return cls(*(getattr(found, field.name) for field in fields(found)))

    def _repr_html_(self) -> str:
        from lidcam.cli.printing.console import print_inspection
        from lidcam.cli.printing.terminal import printed_html

        return printed_html(lambda out: print_inspection(out, self))


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """A finished run.

    Attributes:
        summary: Counts, drops, calibration, times.
        objects: The fused objects of all frames.
    """

    summary: RunSummary
    objects: Objects

    __repr__ = brief

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.summary.frames.count

    @property
    def drops(self) -> tuple[DropCount, ...]:
        """Messages that were not used, by topic and reason."""
        return self.summary.drops.messages

    def _repr_html_(self) -> str:
        """For notebooks: the summary that the command line prints."""
        from lidcam.cli.printing.run import print_summary
        from lidcam.cli.printing.terminal import printed_html

        return printed_html(lambda out: print_summary(out, self.summary))

    def plot(self, axes: Any = None) -> Any:
        """Plot all tracks from above, by class, in the site frame; objects without a track are dots.

        Args:
            axes: matplotlib axes to draw on; None makes a figure.

        Returns:
            The axes.

        Raises:
            LidcamError: matplotlib is not installed.
        """
        objects, rig = self.objects, self.summary.sensors.rig
        axes = axes or _installed("matplotlib.pyplot", "run.plot()").subplots(figsize=(8, 8))[1]
        for zone in rig.counted_zones:
            outline = np.concatenate([zone.polygon_site, zone.polygon_site[:1]])
            axes.plot(*outline.T, color="0.7", linewidth=0.8, zorder=0)
        for class_id in np.unique(objects.class_ids).tolist():
            own = objects.select(objects.class_ids == class_id)
            style: dict[str, Any] = {"color": class_color(class_id), "label": objects.class_names[class_id]}
            for number in np.unique(own.tracks).tolist():
                xy = own.centers[own.tracks == number, :2]
                drawn = {"linestyle": "", "marker": "."} if number == NO_TRACK else {"marker": ".", "markevery": [-1]}
                axes.plot(*xy.T, **style, **drawn)
                style.pop("label", None)
        axes.set_aspect("equal", adjustable="datalim")
        moves = ", which moves" if self.summary.sensors.motion_topics else ""
        axes.set(xlabel="x (m)", ylabel="y (m)", title=f"frame {objects.frame_id}{moves}: {len(objects)} objects")
        if len(objects):
            axes.legend()
        return axes

    def show(self, *, height: int = 600) -> None:
        """Show the .rrd among the outputs of the run in Rerun's viewer, in a notebook.

        Args:
            height: Height of the viewer, pixels.

        Raises:
            LidcamError: there is no Rerun recording, or rerun-notebook is not installed.
        """
        recordings = [path for path in self.summary.outputs if path.suffix == ".rrd"]
        if not recordings:
            raise LidcamError('run.show(): expected an .rrd among the outputs of the run: process(..., ["out.rrd"])')
        _installed("rerun_notebook", "run.show()")
        import rerun
        from rerun.notebook import Viewer

        stream = rerun.RecordingStream("lidcam")
        Viewer(width="auto", height=height, recording=stream).display()
        rerun.log_file_from_path(recordings[0], recording=stream)


def _installed(package: str, wanted_by: str) -> Any:
    try:
        return import_module(package)
    except ImportError as err:
        name = package.partition(".")[0].replace("_", "-")
        raise LidcamError(f"{wanted_by} needs {name}, which is not installed: pip install 'lidcam[notebook]'") from err


class ObjectCollector(RunObserver):
    """Gathers the objects of a run; memory grows with their number, by about 250 bytes each."""

    def __init__(self, on_frame: Callable[[Frame], None] | None = None, progress: RunObserver | None = None) -> None:
        """Gather objects; `on_frame` is called with each frame, and `progress` observes the run, too."""
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
