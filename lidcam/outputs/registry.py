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
    made_of_result: str = ""  # Function that makes its text and what the result lacks, in place of a writer
    # Function that says whether a run of lidcam wrote what stands at a path, so that a later one may replace it. It
    # raises OSError where that cannot be read
    is_own: str = ""
    how_to_open: str = ""  # Instruction to open `{path}`, and the `{layout}` beside it
    folder_of: str = ""  # What a folder holds
    has_layout: bool = False  # Whether a layout for Foxglove is written beside it
    needs: tuple[str, ...] = ()  # Modules that a small installation lacks; a run into a folder then does without it

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


_WRITERS, _ALLOWED = "lidcam.outputs.writers", "lidcam.outputs.allowed"

OUTPUTS = [
    Output("pace", "--pace", open=f"{_WRITERS}:open_pace"),  # holds the others back, so it comes first
    Output("view", "--view", open=f"{_WRITERS}:open_rerun"),
    Output("foxglove", "--foxglove", open=f"{_WRITERS}:open_foxglove"),
    Output(
        "Foxglove",
        "",
        ".mcap",
        f"{_WRITERS}:open_mcap",
        is_own=f"{_ALLOWED}:is_own_mcap",
        how_to_open="open the .mcap{layout} (Lichtblick, too)",
        has_layout=True,
    ),
    Output(
        "Rerun",
        "--rerun",
        ".rrd",
        f"{_WRITERS}:open_rerun",
        is_own=f"{_ALLOWED}:is_own_rrd",
        how_to_open="rerun {path}",
        needs=("rerun",),
    ),
    Output(
        "Parquet",
        "--objects",
        ".parquet",
        f"{_WRITERS}:open_parquet",
        is_own=f"{_ALLOWED}:is_own_parquet",
        how_to_open="open {path} with pandas.read_parquet, polars or DuckDB",
    ),
    Output(
        "CSV",
        "--objects",
        ".csv",
        f"{_WRITERS}:open_csv",
        is_own=f"{_ALLOWED}:is_own_csv",
        how_to_open="open {path} in a spreadsheet, or pandas.read_csv",
    ),
    Output(
        "Film",
        "--video",
        ".mp4",
        f"{_WRITERS}:open_film",
        is_own=f"{_ALLOWED}:is_own_film",
        how_to_open="open {path} in a browser or a player",
    ),
    Output(
        "Report",
        "--report",
        ".html",
        made_of_result="lidcam.outputs.report.make:make_page",
        is_own=f"{_ALLOWED}:is_own_page",
        how_to_open="open {path} in a browser",
        needs=("jinja2", "scipy"),
    ),
    Output(
        "Images",
        "--save-matches",
        "",
        f"{_WRITERS}:open_matches",
        is_own=f"{_ALLOWED}:are_own_images",
        how_to_open="look at the .jpg in {path}",
        folder_of="images",
    ),
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
