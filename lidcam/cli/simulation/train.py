"""The commands `lidcam train ...`."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Literal, Unpack

import typer

from lidcam.cli.options import GroupedCommand, Overwrite, ends_in, option, with_job_options, with_log_options
from lidcam.pipeline.core.errors import ConfigError, LidcamError, OutputError
from lidcam.run.options import SharedOptions

if TYPE_CHECKING:
    from lidcam.pipeline.core.settings.config import Config
    from lidcam.training.labelled import Recordings as LabelledRecordings
    from lidcam.training.pillars.fit import Checkpoint
    from lidcam.training.pillars.train import Judged, Trained

train_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

Recordings = Annotated[
    list[str] | None,
    option(
        "Recording with ground-truth topics to learn from; may be repeated. With --family: half of the scenes.",
        "--recordings",
        metavar="RECORDING",
    ),
]
Seed = Annotated[int, option("Random seed: the number of the first world.", metavar="N", min=0)]
Resume = Annotated[bool, option("Continue from FILE.ckpt if it exists; steps and recordings may change.", "--resume")]
NetworkOut = Annotated[
    Path,
    option(
        "The network; FILE.md beside it is its card, FILE.ckpt the state of the training.",
        "--out",
        metavar="FILE.onnx",
        callback=ends_in(".onnx"),
    ),
]
READING = with_job_options("config", "settings", "rig", "workers")
"""A decorator of commands that learn from recordings."""

DEFAULT_FAMILY = "[default: road, or the recordings alone]"

CLUSTERS_EXAMPLES = """\b
Examples:
  lidcam train clusters --out mine.npz
  lidcam train clusters --family all --worlds 600 --out mine.npz
  lidcam train clusters --recordings labelled.mcap --family road --out mine.npz
  lidcam process drive.mcap out.mcap --set detect3d.weights=mine.npz
"""
PILLARS_EXAMPLES = """\b
Examples:
  lidcam train pillars --steps 20000 --out mine.onnx
  lidcam train pillars --steps 20000 --out mine.onnx --resume
  lidcam train pillars --steps 2000 --out mine.onnx \\
    --recordings labelled.mcap --family all
  lidcam process drive.mcap out.mcap --model-3d mine.onnx
"""
CONVERT_EXAMPLES = """\b
Examples:
  lidcam train convert net.pth --config net.yaml --out mine.onnx
  lidcam process drive.mcap out.mcap --model-3d mine.onnx
"""


@train_app.command(cls=GroupedCommand, epilog=CLUSTERS_EXAMPLES)
@with_log_options
@READING
def clusters(
    out: Annotated[
        Path, option("The weights; FILE.md beside it is their card.", metavar="FILE.npz", callback=ends_in(".npz"))
    ],
    family: Annotated[
        Literal["road", "crossing", "all"] | None,
        option(f"Worlds to learn from: lidars on a car, on masts at a crossing, or both. {DEFAULT_FAMILY}"),
    ] = None,
    worlds: Annotated[
        int, option("Worlds per family, of four sweeps each; recordings count as one family.", metavar="N", min=20)
    ] = 300,
    recordings: Recordings = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    **options: Unpack[SharedOptions],
) -> None:
    """Train the network that scores clusters of lidar points.

    On simulated worlds, on labelled recordings, or on both.
    """
    check_training()
    from lidcam.cli.printing.progress import show_training
    from lidcam.pipeline.parallel.cores import usable_cores
    from lidcam.training.clusters import train_clusters
    from lidcam.writers.outputs.transaction import OutputTransaction

    card, processes = out.with_suffix(".md"), options.get("workers") or usable_cores()
    with OutputTransaction([out, card], check_old=partial(_check_old, overwrite=overwrite)) as outputs:
        with TemporaryDirectory() as folder:
            check = partial(_check_classes, family=family)
            labelled = read(recordings, Path(folder), check, options)
            chosen = family if family or labelled else "road"
            with show_training() as progress:
                network, text = train_clusters(
                    chosen, worlds, seed, workers=processes, progress=progress, recordings=labelled
                )
        outputs[out].write_bytes(network.to_bytes())
        outputs[card].write_text(text)
    typer.echo(text)


@train_app.command(cls=GroupedCommand, epilog=PILLARS_EXAMPLES)
@with_log_options
@READING
def pillars(
    out: NetworkOut,
    steps: Annotated[int, option("Total number of steps, of four sweeps each.", metavar="N", min=1)],
    family: Annotated[
        Literal["road", "crossing", "all", "sandbox"] | None,
        option(
            f"Worlds to learn from: a lidar on a car, on a mast at a crossing, either, at a table. {DEFAULT_FAMILY}"
        ),
    ] = None,
    recordings: Recordings = None,
    seed: Seed = 0,
    begin: Annotated[
        str,
        option(
            "Network to start from: traffic, sandbox, a FILE.onnx that this command wrote, or none. "
            "[default: the bundled one with --recordings, else none]",
            "--from",
            metavar="NAME",
        ),
    ] = "",
    bfloat16: Annotated[
        bool, option("Train in bfloat16: twice as fast on CPUs that support it (AVX-512 BF16, AMX).", "--bfloat16")
    ] = False,
    resume: Resume = False,
    overwrite: Overwrite = False,
    **options: Unpack[SharedOptions],
) -> None:
    """Train a network that finds 3D boxes.

    On simulated worlds, labelled recordings, or both; on a CUDA device if there is one.
    """
    check_training()
    from lidcam.training.pillars.fit import Checkpoint
    from lidcam.training.pillars.scenes import Source

    def checkpoint_in(folder: Path) -> Checkpoint:
        labelled = read(recordings, folder, partial(_check_classes, family=family), options)
        embedded = "sandbox" if family == "sandbox" else "traffic"
        first = begin or (embedded if labelled else "none")
        return Checkpoint(
            path=out.with_suffix(".ckpt"),
            source=Source(family or "road", labelled, bool(family) or not labelled),
            seed=seed,
            begin="" if first == "none" else first,
            bfloat16=bfloat16,
        )

    trained = train_network(
        out, steps, checkpoint_in, workers=options.get("workers"), resume=resume, overwrite=overwrite
    )
    typer.echo(trained.card)


def train_network(
    out: Path,
    steps: int,
    checkpoint_in: Callable[[Path], "Checkpoint"],
    *,
    workers: int | None,
    resume: bool,
    overwrite: bool,
    kept_share: float = 0.0,
    begun: Callable[[Mapping[str, "Judged"]], object] = lambda _: None,
    check: Callable[["Trained"], object] = lambda _: None,
) -> "Trained":
    """Train a network in pillars by `train_pillars`, and write it, its card and its checkpoint.

    `checkpoint_in` may keep frames in the folder that it is given; `check` raises if the network is not worth keeping.
    """
    from lidcam.cli.printing.progress import show_training
    from lidcam.pipeline.detectors.pillars.embedded import existing_network_file
    from lidcam.pipeline.parallel.cores import usable_cores
    from lidcam.training.pillars.train import train_pillars
    from lidcam.writers.outputs.transaction import OutputTransaction

    card, state, processes = out.with_suffix(".md"), out.with_suffix(".ckpt"), workers or usable_cores()
    may_replace = overwrite or (resume and state.exists())
    with OutputTransaction([out, card], check_old=partial(_check_old, overwrite=may_replace)) as outputs:
        with OutputTransaction([state]):
            pass  # it could be written
        if state.exists() and not (resume or overwrite):
            raise OutputError(f"{state}: exists; go on with --resume, or begin anew with --overwrite")
        with TemporaryDirectory() as folder:
            checkpoint = checkpoint_in(Path(folder))
            if not resume:
                if checkpoint.begin:
                    existing_network_file(Path(checkpoint.begin))
                state.unlink(missing_ok=True)
            with show_training() as progress:
                part = outputs[out].part
                trained = train_pillars(
                    checkpoint, part, steps, workers=processes, progress=progress, kept_share=kept_share, begun=begun
                )
        check(trained)
        outputs[card].write_text(trained.card)
    return trained


@train_app.command(cls=GroupedCommand, epilog=CONVERT_EXAMPLES)
@with_log_options
def convert(
    network: Annotated[
        Path, typer.Argument(metavar="NETWORK", help="Checkpoint (.pth) of OpenPCDet or mmdetection3d.")
    ],
    out: Annotated[Path, option("The network for --model-3d.", metavar="FILE.onnx", callback=ends_in(".onnx"))],
    config: Annotated[
        Path | None,
        option(
            "OpenPCDet YAML, or a single-file mmdetection3d config (JSON or Python; parsed, not executed). "
            "[default: the one in an mmdetection3d checkpoint]",
            metavar="FILE",
        ),
    ] = None,
    ground_z: Annotated[
        float | None, option("Ground height in its training data, metres. [default: that of the data set]", metavar="M")
    ] = None,
    intensity_max: Annotated[
        float | None, option("Maximum intensity in its training data. [default: that of the data set]", metavar="N")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Convert a PointPillars or CenterPoint network to ONNX.

    Reads pillar checkpoints of OpenPCDet and mmdetection3d. The result runs without PyTorch.
    """
    _check_extra("reading a checkpoint")
    from lidcam.outputs.allowed import check_no_input
    from lidcam.training.kits.convert import converted
    from lidcam.training.kits.model import Data
    from lidcam.writers.outputs.transaction import OutputTransaction

    check_no_input([out], [network, *([config] if config else [])])
    with OutputTransaction([out], check_old=partial(_check_old, overwrite=overwrite)) as outputs:
        content, specs = converted(network, config, Data(ground_z, intensity_max))
        outputs[out].write_bytes(content)
    low, high = specs.grid.low_m, specs.grid.high_m
    typer.echo(f"{out}: finds {', '.join(one.name for one in specs.classes)}")
    typer.echo(f"x from {low[0]:g} to {high[0]:g} m, y from {low[1]:g} to {high[1]:g} m")
    typer.echo(f"ground at {specs.ground_z_m:g} m, intensities to {specs.intensity_max:g}")


def check_training() -> None:
    """Raise if an extra is not installed that the training needs."""
    from lidcam.simulation import check_simulator

    check_simulator()
    _check_extra("the training")


def _check_extra(purpose: str) -> None:
    if missing := [name for name in ("torch", "onnx") if find_spec(name) is None]:
        raise LidcamError(
            f"{purpose} needs {' and '.join(missing)}, which is not installed: pip install 'lidcam[train]'"
        )


def read(
    recordings: Sequence[str] | None,
    folder: Path,
    check: Callable[["Config"], object],
    options: SharedOptions,
    *,
    own_labels: bool = False,
) -> "LabelledRecordings | None":
    """Recordings to learn from, as by `read_recordings`; None if there are none. `options` are those of `READING`."""
    if not recordings:
        if options.keys() - {"workers"}:
            raise typer.BadParameter("--config, --set and --rig say how to read recordings: give --recordings, too")
        return None
    from lidcam.cli.printing.progress import show_training
    from lidcam.training.recordings import read_recordings

    with show_training() as progress:
        return read_recordings(recordings, folder, check=check, progress=progress, own_labels=own_labels, **options)


def _check_classes(config: "Config", *, family: str | None) -> None:
    """Refuse recordings of classes, or of a size, that the network does not know."""
    from lidcam.pipeline.detectors.cluster.kinds import knows

    is_sandbox = family == "sandbox"
    if knows(config.classes) != is_sandbox:
        return
    expected, remedy = "road users of full size, as of --config road", "for model sites there is lidcam train pillars"
    if is_sandbox:
        expected, remedy = "model cars, as of --config sandbox", "leave out"
    raise ConfigError(
        f"training from recordings: expected {expected}, found the classes {', '.join(config.class_names)}; {remedy} "
        "--family sandbox"
    )


def _check_old(path: Path, *, overwrite: bool) -> None:
    if not overwrite:
        raise OutputError(f"{path}: exists; choose another name, or replace it with --overwrite")
