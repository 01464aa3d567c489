"""Runs and inspections to work on: tables, plots, a viewer."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

from lidcam.batches.records import BatchResult
from lidcam.evaluation.compare import ComparedResults
from lidcam.evaluation.evaluation import Evaluation
from lidcam.inspection import Inspection
from lidcam.notebook.counting import Line, LineCount, count_lines
from lidcam.notebook.plots import installed, plot_counts, plot_speeds, plot_tracks
from lidcam.notebook.site_map import MakeMap, MapCollector, no_map
from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.errors import ConfigError, LidcamError
from lidcam.pipeline.core.text import brief
from lidcam.processing import RunObserver
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.summary import DropCount, RunSummary
from lidcam.run.tally import RunProgress
from lidcam.writers.tables.objects import Objects

if TYPE_CHECKING:
    from rich.console import Console

SpeedUnits = Literal["km/h", "m/s"]


class Shown(ABC):
    """A result that `print` and a notebook show as a command prints it."""

    __slots__ = ()

    @classmethod
    def of(cls, made: Any) -> Self:
        """The same dataclass, shown."""
        return cls(*(getattr(made, field.name) for field in fields(made)))

    @abstractmethod
    def print_on(self, out: "Console") -> None:
        """Print it on a console."""

    def __str__(self) -> str:
        from lidcam.cli.printing.terminal import printed_text

        return printed_text(self.print_on)

    def _repr_html_(self) -> str:
        from lidcam.cli.printing.terminal import printed_html

        return printed_html(self.print_on)


class ShownInspection(Shown, Inspection):
    """An inspection that `print` and a notebook show as `lidcam inspect` does."""

    __slots__ = ()

    def print_on(self, out: "Console") -> None:
        """See `Shown`."""
        from lidcam.cli.printing.console import print_inspection

        print_inspection(out, self)


class ShownBatch(Shown, BatchResult):
    """A batch that `print` and a notebook show as `lidcam batch` does."""

    __slots__ = ()

    def print_on(self, out: "Console") -> None:
        """See `Shown`."""
        from lidcam.cli.printing.batch import print_batch

        print_batch(out, self.records)


class ShownEvaluation(Shown, Evaluation):
    """An evaluation that `print` and a notebook show as `lidcam evaluate` does."""

    __slots__ = ()

    def print_on(self, out: "Console") -> None:
        """See `Shown`."""
        from lidcam.cli.printing.evaluation import print_evaluation

        print_evaluation(out, self)


class ShownComparison(Shown, ComparedResults):
    """A comparison that `print` and a notebook show as `lidcam compare` does."""

    __slots__ = ()

    def print_on(self, out: "Console") -> None:
        """See `Shown`."""
        from lidcam.cli.printing.comparison import print_comparison

        print_comparison(out, self.figures.tree, [file.path for file in self.inputs], lines=10)


@dataclass(frozen=True, slots=True, eq=False)
class RunResult(Shown):
    """A finished run. `print` shows it in short, a notebook as the command line does.

    Attributes:
        summary: Counts, drops, calibration, times.
        objects: The fused objects of all frames.
        make_map: Gives the map that `plot` draws on.
    """

    summary: RunSummary
    objects: Objects
    make_map: MakeMap = no_map

    __repr__ = brief

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.summary.frames.count

    @property
    def drops(self) -> tuple[DropCount, ...]:
        """Messages that were not used, by topic and reason."""
        return self.summary.drops.messages

    def print_on(self, out: "Console") -> None:
        """See `Shown`."""
        from lidcam.cli.printing.run import print_summary

        print_summary(out, self.summary)

    def count_lines(self, lines: Mapping[str, Line]) -> tuple[LineCount, ...]:
        """Count the road users that cross lines, each once, by class and direction.

        Args:
            lines: By name, the two ends ((x, y), (x, y)) of each, metres, in the frame that `plot` shows: the site
                frame, or a fixed one if the sensors moved.

        Raises:
            ConfigError: a line is none.
        """
        return count_lines(self.objects, self.make_map().places(self.objects), lines)

    def plot(self, axes: Any = None, *, lines: Mapping[str, Line] | None = None) -> Any:
        """Plot all tracks from above, in the colours of their classes, over the points of the lidars.

        A dot is where a track was last. If the sensors moved, tracks are in the fixed frame of their recorded motion,
        or of the motion that the clouds show; where neither is known, as in a result that was loaded, they are as seen
        from the sensors.

        Args:
            axes: matplotlib axes to draw on; None makes a figure.
            lines: Lines to draw, as for `count_lines`; the name of each stands at its first end.

        Returns:
            The matplotlib axes.

        Raises:
            LidcamError: matplotlib is not installed.
        """
        return plot_tracks(self.objects, self.make_map(), self.summary.sensors.rig, lines or {}, axes)

    def plot_speeds(self, axes: Any = None, *, units: SpeedUnits = "km/h") -> Any:
        """Plot how many road users were how fast over the ground: the median speed of each that moved, by class.

        It moved if it did in some frame: at 0.3 m/s or more, and beyond the uncertainty of its velocity.

        Args:
            axes: matplotlib axes to draw on; None makes a figure.
            units: Of the speeds.

        Returns:
            The matplotlib axes.

        Raises:
            LidcamError: matplotlib is not installed, or `units` are others.
        """
        if units not in get_args(SpeedUnits):
            raise ConfigError(f"units: expected {' or '.join(get_args(SpeedUnits))}, found {units!r}")
        return plot_speeds(self.objects, axes, km_h=units == "km/h")

    def plot_counts(self, axes: Any = None, *, lines: Mapping[str, Line] | None = None) -> Any:
        """Plot how many road users there were, in all, in each zone, and across lines in each direction, by class.

        Args:
            axes: matplotlib axes to draw on; None makes a figure.
            lines: Lines whose crossings are counted, as for `count_lines`.

        Returns:
            The matplotlib axes.

        Raises:
            LidcamError: matplotlib is not installed, a line is none, or nothing was tracked.
        """
        users = self.summary.road_users
        if users is None:
            raise LidcamError("run.plot_counts(): expected tracks, found a run without them (track.mode none)")
        lines = lines or {}
        return plot_counts(users, lines, self.count_lines(lines), self.objects.class_names, axes)

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
        installed("rerun_notebook", "run.show()")
        import rerun
        from rerun.notebook import Viewer

        stream = rerun.RecordingStream("lidcam")
        Viewer(width="auto", height=height, recording=stream).display()
        rerun.log_file_from_path(recordings[0], recording=stream)


class ObjectCollector(RunObserver):
    """Gathers the objects and the map of a run; memory grows by about 250 bytes an object, and 130 a frame."""

    def __init__(self, on_frame: Callable[[Frame], None] | None = None, progress: RunObserver | None = None) -> None:
        """Gather objects; `on_frame` is called with each frame, and `progress` observes the run, too."""
        self._frames: list[Objects] = []
        self._on_frame = on_frame
        self._progress = progress or RunObserver()

    def opened(self, source: RunInput) -> None:
        """Take over the sensors, with the zones, and the names of the classes."""
        self._frames, self._map = [Objects.empty(source.rig, source.config.object_names)], MapCollector(source)
        self._progress.opened(source)

    def frame(self, result: Frame) -> None:
        """Take over the objects of one frame."""
        self._frames.append(result.objects)
        self._map.add_frame(result)
        if self._on_frame is not None:
            self._on_frame(result)

    def advanced(self, progress: RunProgress) -> None:
        """Pass on how far the run is."""
        self._progress.advanced(progress)

    def finishing(self) -> None:
        """Pass on that the frames are written."""
        self._progress.finishing()

    @property
    def objects(self) -> Objects:
        """The objects of the frames so far; the recording has to be open, or to have been."""
        return join_rows(*self._frames)

    def result(self, summary: RunSummary) -> RunResult:
        """The run that has ended with this summary."""
        return RunResult(summary, self.objects, self._map.site_map)
