"""A finished run, for notebooks: its tables, its tracks as a picture, its recording in a viewer."""

from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any, Self

import numpy as np

from lidcam.inspection import Inspection
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.run.summary import DropCount, RunSummary
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
        report: Counts, drops, calibration, times.
        objects: The fused objects of all frames.
    """

    report: RunSummary
    objects: Objects

    __repr__ = brief

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.report.frames.count

    @property
    def drops(self) -> tuple[DropCount, ...]:
        """Messages that were not used, by topic and reason."""
        return self.report.drops.messages

    def _repr_html_(self) -> str:
        """For notebooks: the final tables of the command line."""
        from lidcam.cli.printing.console import print_report
        from lidcam.cli.printing.terminal import printed_html

        return printed_html(lambda out: print_report(out, self.report))

    def plot(self, axes: Any = None) -> Any:
        """Draw all tracks from above, by class, in the site frame; objects without a track are dots.

        Args:
            axes: matplotlib axes to draw on; None makes a figure.

        Returns:
            The axes.

        Raises:
            LidcamError: matplotlib is not installed.
        """
        objects, rig = self.objects, self.report.sensors.rig
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
        moves = ", which moves" if self.report.sensors.motion_topics else ""
        axes.set(xlabel="x (m)", ylabel="y (m)", title=f"frame {objects.frame_id}{moves}: {len(objects)} objects")
        if len(objects):
            axes.legend()
        return axes

    def show(self, *, height: int = 600) -> None:
        """Show the run in Rerun's viewer, in a notebook.

        The run has to have an .rrd among its outputs.

        Args:
            height: Of the viewer, in pixels.

        Raises:
            LidcamError: there is no Rerun recording, or rerun-notebook is not installed.
        """
        recordings = [path for path in self.report.outputs if path.suffix == ".rrd"]
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
