"""Training of a network in pillars, from worlds to an ONNX file and its card."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import torch

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.detectors.pillars.network import FoundClass, PillarNetwork, PillarSpecs
from lidcam.training.labelled import WORLDS, loaded
from lidcam.training.pillars import network as torch_network
from lidcam.training.pillars.fit import BATCH, CHECKPOINT_EVERY_S, Checkpoint, fitted
from lidcam.training.pillars.judging import (
    SWEEPS_OF_A_WORLD,
    Judged,
    calibration,
    figures,
    joined,
    judged,
    judged_frame,
    with_errors,
)
from lidcam.training.pillars.onnx_file import onnx_bytes
from lidcam.training.pillars.scenes import CLASSES, GRIDS, MIN_POINTS, WRITTEN_GRIDS

HELD_OUT = 1_000_000
"""Worlds from this number (plus the seed) on are not trained on: some calibrate the network, others judge it."""

MAX_HELD_OUT = 80

FITTING = 0.98
"""Share of the time that the steps take."""

Told = Callable[[float, str], object]
"""Called with the share that is done, and a text to show with it."""


def train_pillars(
    checkpoint: Checkpoint, out: Path, steps: int, *, workers: int, told: Told, every_s: float = CHECKPOINT_EVERY_S
) -> str:
    """Train a network, or continue from its checkpoint, write it as an ONNX file, and return its card in Markdown.

    Args:
        checkpoint: Where the state of the training is, with its worlds and their first number.
        out: File to write.
        steps: Number of steps in all.
        workers: Processes that make scenes.
        told: Told of progress.
        every_s: Wall time between checkpoints.

    Raises:
        LidcamError: the checkpoint cannot be used.
        OutputError: it cannot be written.
    """
    worlds, seed, recordings = checkpoint.worlds, checkpoint.seed, checkpoint.recordings

    def learning(step: int, loss: float) -> None:
        told(FITTING * step / steps, f"step {step} of {steps}, loss {loss:.3f}")

    network = fitted(checkpoint, steps, workers=workers, told=learning, every_s=every_s)
    half = min(max(steps // 100, 1), MAX_HELD_OUT // 2)

    def seen(part: int) -> dict[str, Judged]:
        """Boxes in the data kept apart, by source; the first part calibrates, the second judges."""
        net, found, first = PillarNetwork(out), {}, HELD_OUT + seed + part * half
        if checkpoint.has_worlds:
            found[WORLDS] = joined([*_told_of(judged(net, worlds, range(first, first + half)), part)])
        if recordings is not None:
            frames = map(loaded, (recordings.calibrate, recordings.judge)[part])
            found["recordings"] = joined([judged_frame(net, worlds, frame) for frame in frames])
        return found

    def _told_of(found: Iterator[Judged], part: int) -> Iterator[Judged]:
        for row, one in enumerate(found, part * half + 1):
            told(FITTING + (1 - FITTING) * row / (2 * half), f"held-out world {row} of {2 * half}")
            yield one

    specs = PillarSpecs(classes=tuple(FoundClass(name=name) for name in CLASSES[worlds]), grid=WRITTEN_GRIDS[worlds])
    out.write_bytes(onnx_bytes(network, specs, GRIDS[worlds]))
    parts = seen(0)
    if recordings is not None and checkpoint.has_worlds:  # give them as much weight as the worlds
        sweeps = half * SWEEPS_OF_A_WORLD
        parts["recordings"] = joined([parts["recordings"]] * max(sweeps // len(recordings.calibrate), 1))
    found = joined([*parts.values()])
    _calibrate(network, calibration(found))
    specs = specs.model_copy(update={"classes": with_errors(CLASSES[worlds], found)})
    out.write_bytes(onnx_bytes(network, specs, GRIDS[worlds]))
    tables = {name: figures(CLASSES[worlds], one) for name, one in seen(1).items()}
    return _card(checkpoint, steps, half, tables)


def _calibrate(network: torch_network.PillarNetwork, by_class: F64) -> None:
    """Change the last layer to apply a factor and an offset to the log odds of each class, (C, 2)."""
    factor, offset = torch.from_numpy(by_class.T.astype(np.float32))
    last, classes = network.cpu().last, slice(len(by_class))
    with torch.no_grad():
        last.weight[classes] *= factor[:, None, None, None]
        network.last_bias[classes] = network.last_bias[classes] * factor + offset


def _card(checkpoint: Checkpoint, steps: int, half: int, tables: Mapping[str, str]) -> str:
    family = f" --family {checkpoint.worlds}" if checkpoint.has_worlds else ""
    recordings = " --recordings RECORDING \\\n     " if checkpoint.recordings else ""
    how = " --bfloat16 \\\n     " if checkpoint.bfloat16 else ""
    sources = "\n".join(f"- from step {step} on {text}" for step, text in checkpoint.load()["history"])
    table = "\n\n".join(f"In {name}:\n\n{table}" for name, table in tables.items())
    apart = [f"{2 * half} other worlds"] * checkpoint.has_worlds + ["the frames kept apart"] * bool(recordings)
    return f"""# A 3D network in pillars

    lidcam train pillars{family}{recordings}{how} --steps {steps} --seed {checkpoint.seed} --out FILE.onnx

made this network from {steps * BATCH} sweeps:

{sources}

Of {" and ".join(apart)},
half made its scores probabilities. In the other half, of objects of
{MIN_POINTS} points and more within the grid:

{table}

Found and false: boxes of a probability of 0.5 and more. AP: average precision.
ECE: calibration error of boxes from 0.05 on. Position and heading: medians of
those found, front and rear taken for the same; turned: the share turned round.

    lidcam-process drive.mcap out.mcap --model-3d FILE.onnx
"""
