"""The commands `lidcam train ...`."""

from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import typer

from lidcam.commands.options import Overwrite, ends_in, with_log_options
from lidcam.commands.simulation.simulate import check_simulator
from pipeline.core.errors import LidcamError, OutputError

__all__ = ["train_app"]

train_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

# \b keeps the lines of a paragraph as they are.
CLUSTERS_EXAMPLES = """\b
Examples:
  lidcam train clusters --out mine.npz
  lidcam train clusters --family all --worlds 600 --out mine.npz
  lidcam-process drive.mcap out.mcap --set detect3d.weights=mine.npz
"""
PILLARS_EXAMPLES = """\b
Examples:
  lidcam train pillars --steps 20000 --out mine.onnx
  lidcam train pillars --steps 20000 --out mine.onnx --resume
  lidcam-process drive.mcap out.mcap --model-3d mine.onnx
"""
IMAGES_EXAMPLES = """\b
Examples:
  lidcam train images --steps 4000 --out detector.onnx
  lidcam-process drive.mcap out.mcap --model-2d detector.onnx
"""


@train_app.callback()
def _train() -> None:
    pass


@train_app.command(epilog=CLUSTERS_EXAMPLES)
@with_log_options
def clusters(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE.npz", callback=ends_in(".npz"), help="The weights; FILE.md beside it is their card."
        ),
    ],
    family: Annotated[
        Literal["road", "crossing", "all"],
        typer.Option("--family", help="Worlds to learn from: lidars on a car, on masts at a crossing, or both."),
    ] = "road",
    worlds: Annotated[int, typer.Option(min=20, metavar="N", help="Worlds of each family.")] = 300,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Number of the first world; others, other weights.")
    ] = 0,
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes; the weights are the same. [default: cores]")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Train the network that scores clusters of lidar points, on simulated worlds."""
    check_simulator()
    from lidcam.printing.progress import show_training
    from lidcam.training.clusters import train_clusters
    from pipeline.parallel.cores import usable_cores
    from writers.outputs.errors import output_errors
    from writers.outputs.transaction import OutputTransaction

    card = out.with_suffix(".md")
    with OutputTransaction([out, card], check_old=partial(_check_old, overwrite=overwrite)) as outputs:
        with show_training() as told:
            trained = train_clusters(family, worlds, seed, workers=workers or usable_cores(), told=told)
        with output_errors(out), outputs[out].part.open("xb") as file:
            file.write(trained.network.to_bytes())
        outputs[card].write_text(trained.card)
    typer.echo(trained.card)


@train_app.command(epilog=PILLARS_EXAMPLES)
@with_log_options
def pillars(
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="FILE.onnx",
            callback=ends_in(".onnx"),
            help="The network; FILE.md beside it is its card, FILE.ckpt the state of the training.",
        ),
    ],
    steps: Annotated[int, typer.Option(min=1, metavar="N", help="Steps in all, of four sweeps each.")],
    family: Annotated[
        Literal["road", "crossing", "sandbox"],
        typer.Option("--family", help="Worlds to learn from: a lidar on a car, on a mast at a crossing, at a table."),
    ] = "road",
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Number of the first world; others, another network.")
    ] = 0,
    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Processes that make sweeps; these are the same. [default: cores]"),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from FILE.ckpt, if there is one; also with more steps.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Train a network that finds 3D boxes, on simulated worlds; on a CUDA device if there is one."""
    _check_torch()
    from lidcam.printing.progress import show_training
    from lidcam.training.pillars.fit import Checkpoint
    from lidcam.training.pillars.train import train_pillars
    from pipeline.parallel.cores import usable_cores
    from writers.outputs.transaction import OutputTransaction

    card, checkpoint = out.with_suffix(".md"), Checkpoint(out.with_suffix(".ckpt"), family, seed)
    with OutputTransaction([out, card], check_old=partial(_check_old, overwrite=overwrite or resume)) as outputs:
        if checkpoint.path.exists() and not resume:
            if not overwrite:
                raise OutputError(f"{checkpoint.path}: exists; go on with --resume, or begin anew with --overwrite")
            checkpoint.path.unlink()
        with show_training() as told:
            text = train_pillars(checkpoint, outputs[out].part, steps, workers=workers or usable_cores(), told=told)
        outputs[card].write_text(text)
    typer.echo(text)


@train_app.command(epilog=IMAGES_EXAMPLES)
@with_log_options
def images(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE.onnx", callback=ends_in(".onnx"), help="The network; FILE.md beside it is its card."
        ),
    ],
    steps: Annotated[int, typer.Option(min=1, metavar="N", help="Steps, of eight parts of images each.")],
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Number of the first world; others, another network.")
    ] = 0,
    overwrite: Overwrite = False,
) -> None:
    """Train a network that finds 2D boxes in simulated images, on drawn worlds; in real images it is of no use."""
    _check_torch()
    from lidcam.printing.progress import show_training
    from lidcam.training.images.train import train_images
    from writers.outputs.transaction import OutputTransaction

    card = out.with_suffix(".md")
    with OutputTransaction([out, card], check_old=partial(_check_old, overwrite=overwrite)) as outputs:
        with show_training() as told:
            text = train_images(outputs[out].part, steps, seed, told=told)
        outputs[card].write_text(text)
    typer.echo(text)


def _check_torch() -> None:
    check_simulator()
    if find_spec("torch") is None:
        raise LidcamError("the training needs torch, which is not installed: pip install 'lidcam[train]'")


def _check_old(path: Path, *, overwrite: bool) -> None:
    """Refuse to replace a file that is not meant to be."""
    if not overwrite:
        raise OutputError(f"{path}: exists; choose another name, or replace it with --overwrite")
