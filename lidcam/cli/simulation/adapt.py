"""The command `lidcam adapt`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Unpack

import typer

from lidcam.cli.options import Overwrite, option, with_log_options
from lidcam.cli.printing.log import remark_log
from lidcam.cli.simulation.train import READING, NetworkOut, Resume, Seed, check_training, read, train_network
from lidcam.pipeline.core.errors import ConfigError, LidcamError
from lidcam.run.options import SharedOptions

if TYPE_CHECKING:
    from lidcam.pipeline.core.settings.config import Config
    from lidcam.training.pillars.scenes import Worlds
    from lidcam.training.pillars.train import Judged, Trained

KEPT_SHARE = 0.5
"""Share of the original network's weights in the written ones. On a KITTI drive with 143 false cars before, 0.5 leaves
87 and 0 leaves 62, but average precision in simulated worlds falls by 0.8 and 2.5 points."""

ADAPT_EXAMPLES = """\b
Examples:
  lidcam adapt drive.mcap --out mine.onnx
  lidcam adapt monday.bag tuesday.bag --out mine.onnx --steps 1600
  lidcam process drive.mcap out.mcap --model-3d mine.onnx
"""


@with_log_options
@READING
def adapt(
    recordings: Annotated[
        list[str],
        typer.Argument(metavar="RECORDING...", help="Recordings of the sensors and places that the network is for."),
    ],
    out: NetworkOut,
    steps: Annotated[int, option("Total number of steps, of four sweeps each.", metavar="N", min=1)] = 800,
    seed: Seed = 0,
    resume: Resume = False,
    overwrite: Overwrite = False,
    **options: Unpack[SharedOptions],
) -> None:
    """Adapt the 3D network to your sensors, without labels.

    Recordings are processed with offline tracks. Objects of sure tracks become the labels: seen in several frames, and
    probable by all lidars and cameras. Half of the scenes come from simulated worlds. The last fifth of each recording
    is held out; the network is written only if its average precision there is higher than before.
    """
    check_training()
    from lidcam.pipeline.detectors.cluster.kinds import knows
    from lidcam.run.box_sources import network_3d
    from lidcam.training.labelled import RECORDINGS, WORLDS
    from lidcam.training.pillars.fit import Checkpoint
    from lidcam.training.pillars.scenes import Source
    from lidcam.training.pillars.train import precision_of

    networks: dict[Path, Worlds] = {}

    def check(config: "Config") -> None:
        network = network_3d(config)
        if network is None or networks.keys() - {network}:
            raise ConfigError(
                f"expected recordings that use the same 3D network, found {network.name if network else 'none'} for "
                f"the classes {', '.join(config.class_names)}; lidcam config shows the presets"
            )
        networks[network] = "all" if knows(config.classes) else "sandbox"

    def checkpoint_in(folder: Path) -> Checkpoint:
        labelled = read(recordings, folder, check, options, own_labels=True)
        ((network, worlds),) = networks.items()
        return Checkpoint(out.with_suffix(".ckpt"), Source(worlds, labelled), seed, begin=str(network))

    def begun(before: "Mapping[str, Judged]") -> None:
        if not before[RECORDINGS].objects.any():
            raise LidcamError(
                f"{title}: expected objects of sure tracks in the last tenth of a recording, by which the network is "
                "judged, found none; give longer recordings, or others"
            )
        if precision_of(before[RECORDINGS]) == 1:
            raise LidcamError(
                f"{title}: nothing to gain: the network already finds every object in the held-out frames, and nothing "
                "else"
            )

    def check_gain(trained: "Trained") -> None:
        before, after = (precision_of(one[RECORDINGS]) for one in (trained.before, trained.after))
        if after <= before:
            raise LidcamError(
                f"{title}: nothing gained: average precision in the held-out frames {before:.3f} before, {after:.3f} "
                "after; no network written"
            )

    title = ", ".join(recordings)
    trained = train_network(
        out,
        steps,
        checkpoint_in,
        workers=options.get("workers"),
        resume=resume,
        overwrite=overwrite,
        kept_share=KEPT_SHARE,
        begun=begun,
        check=check_gain,
    )
    for name, what in ((RECORDINGS, "held-out frames, measured against their tracks"), (WORLDS, "simulated worlds")):
        before, after = (precision_of(one[name]) for one in (trained.before, trained.after))
        typer.echo(f"average precision in {what}: {before:.3f} before, {after:.3f} after")
    remark_log.info("wrote %s, %s", out, out.with_suffix(".md"))
    remark_log.info("to use it: lidcam process %s out.mcap --model-3d %s", recordings[0], out)
