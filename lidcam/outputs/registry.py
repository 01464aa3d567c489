"""Everything that lidcam can write, one row each: the run, the command line, batches and `lidcam view` read these rows.

Writers are named as `module:name` and loaded when they are wanted: `--help` reads the rows, too.
"""

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from lidcam.pipeline.core.settings.config import Config
    from lidcam.run.job import Job


@dataclass(frozen=True, slots=True)
class Output:
    """An output of a run."""

    name: str  # The viewer that opens it, for the last lines of a run
    option: str  # Option of `lidcam process` and switch of `lidcam batch` that ask for it; empty: the result itself
    # Ending of its name; empty: a folder; None: no file, but a view of the run while it goes on
    ending: str | None = None
    open: str = ""  # Function that makes its `ResultWriter` of an `Opening` (`lidcam.outputs.writers`)
    # Function that says whether a run of lidcam wrote what stands at a path, so that a later one may replace it. It
    # raises OSError where that cannot be read
    is_own: str = ""
    how_to_open: str = ""  # Instruction to open `{path}`, and the `{layout}` beside it
    made_of_result: str = ""  # Function that makes its text and what the result lacks, in place of a writer
    needs: tuple[str, ...] = ()  # Modules that a small installation lacks; a run into a folder then does without it
    folder_of: str = ""  # What a folder holds
    has_layout: bool = False  # Whether a layout for Foxglove is written beside it

    def beside(self, path: Path, config: "Config") -> tuple[Path, ...]:
        """The texts that are written beside it."""
        if not (self.has_layout and config.output.layout):
            return ()
        from lidcam.writers.foxglove.layout import layout_path

        return (layout_path(path),)

    def instruction(self, path: Path, beside: tuple[Path, ...]) -> str:
        """How it is opened."""
        layout = "".join(f", then Layouts, Import from file, {one.name}" for one in beside)
        return self.how_to_open.format(path=path, layout=layout)


def _file(name: str, option: str, ending: str, kind: str, how_to_open: str, **more: Any) -> Output:
    """An output whose functions are called by its kind."""
    functions = f"lidcam.outputs.writers:open_{kind}", f"lidcam.outputs.allowed:is_own_{kind}"
    return Output(name, option, ending, *functions, how_to_open, **more)


OUTPUTS = [
    Output("pace", "--pace", open="lidcam.outputs.writers:open_pace"),  # holds the others back, so it comes first
    Output("view", "--view", open="lidcam.outputs.writers:open_rerun"),
    Output("foxglove", "--foxglove", open="lidcam.outputs.writers:open_foxglove"),
    _file("Foxglove", "", ".mcap", "mcap", "open the .mcap{layout} (Lichtblick, too)", has_layout=True),
    _file("Rerun", "--rerun", ".rrd", "rerun", "rerun {path}", needs=("rerun",)),
    _file("Parquet", "--objects", ".parquet", "parquet", "open {path} with pandas.read_parquet, polars or DuckDB"),
    _file("CSV", "--objects", ".csv", "csv", "open {path} in a spreadsheet, or pandas.read_csv"),
    _file("Film", "--video", ".mp4", "film", "open {path} in a browser or a player"),
    Output(
        "Report",
        "--report",
        ".html",
        made_of_result="lidcam.outputs.report.make:make_page",
        is_own="lidcam.outputs.allowed:is_own_page",
        how_to_open="open {path} in a browser",
        needs=("jinja2", "scipy"),
    ),
    _file("Images", "--save-matches", "", "matches", "look at the .jpg in {path}", folder_of="images"),
]
"""Outputs and views of a run."""

DatasetFormat = Literal["kitti", "kitti-tracking", "nuscenes", "coco", "yolo", "cvat"]

DATASETS: dict[DatasetFormat, str] = {
    "kitti": "lidcam.writers.datasets.kitti:KittiWriter",
    "kitti-tracking": "lidcam.writers.datasets.kitti:KittiTrackingWriter",
    "nuscenes": "lidcam.writers.datasets.nuscenes:NuScenesWriter",
    "coco": "lidcam.writers.datasets.images:CocoWriter",
    "yolo": "lidcam.writers.datasets.images:YoloWriter",
    "cvat": "lidcam.writers.datasets.cvat:CvatWriter",
}
"""Formats of `lidcam export`: the `DatasetWriter` of each, or its `ImageWriter`."""


def output_of(path: PurePath) -> Output | None:
    """The row of a file or folder by its name."""
    return next((output for output in OUTPUTS if output.ending == path.suffix), None)


def endings_of(option: str) -> tuple[str, ...]:
    """The endings of the names that an option takes; the first is that of a batch."""
    return tuple(output.ending or "" for output in OUTPUTS if output.option == option)


def usual_endings() -> list[str]:
    """The endings of what a run into a folder writes, as far as this installation can."""
    can = [row.ending for row in OUTPUTS if row.ending and row.needs and all(map(find_spec, row.needs))]
    return [".mcap", *can]


def written_outputs(job: "Job") -> list[tuple[Path, Output]]:
    """The files and folders of a job, which are of known kinds."""
    return [(path, output) for path in job.outputs if (output := output_of(path)) is not None]


def shown_outputs(job: "Job") -> list[Output]:
    """The views of a job while it goes on."""
    views = [output for output in OUTPUTS if output.ending is None]
    return [output for output in views if getattr(job, output.option.strip("-")) not in (None, False)]


def loaded(name: str) -> Any:
    """The object that a row names as `module:name`."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)
