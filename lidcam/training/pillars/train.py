"""Training of a network in pillars, from worlds to an ONNX file and its card."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch

from lidcam.pipeline.detectors.pillars.network import FoundClass, PillarNetwork, PillarSpecs
from lidcam.training.labelled import WORLDS, loaded
from lidcam.training.pillars.fit import BATCH, CHECKPOINT_EVERY_S, Checkpoint, fitted
from lidcam.training.pillars.judging import (
    SWEEPS_OF_A_WORLD,
    Judged,
    calibration,
    figures,
    joined,
    judged_frame,
    judged_world,
    with_errors,
)
from lidcam.training.pillars.onnx_file import onnx_bytes
from lidcam.training.pillars.scenes import CLASSES, GRIDS, MIN_POINTS, WRITTEN_GRIDS

FIRST_HELD_OUT = 1_000_000
"""Number of the first world (plus the seed) that is not trained on: some calibrate the network, others judge it."""

MAX_HELD_OUT = 80

FITTING_SHARE = 0.98
"""Share of the time that the steps take."""

Progress = Callable[[float, str], object]
"""Called with the share that is done, and a text to show with it."""


def train_pillars(
    checkpoint: Checkpoint,
    out: Path,
    steps: int,
    *,
    workers: int,
    progress: Progress,
    every_s: float = CHECKPOINT_EVERY_S,
) -> str:
    """Train a network, or continue from its checkpoint, write it as an ONNX file, and return its card in Markdown.

    Args and Raises: as for `fitted`.
    """
    worlds, seed, recordings = checkpoint.worlds, checkpoint.seed, checkpoint.recordings

    def step_done(step: int, loss: float) -> None:
        progress(FITTING_SHARE * step / steps, f"step {step} of {steps}, loss {loss:.3f}")

    network = fitted(checkpoint, steps, workers=workers, step_done=step_done, every_s=every_s)
    half = min(max(steps // 100, 1), MAX_HELD_OUT // 2)

    def judge_held_out(part: int) -> dict[str, Judged]:
        """Boxes in the data kept apart, by source; part 0 calibrates, part 1 judges."""
        written, found = PillarNetwork(out), {}
        if checkpoint.has_worlds:
            first, parts = FIRST_HELD_OUT + seed + part * half, []
            for row, number in enumerate(range(first, first + half), part * half + 1):
                parts.append(judged_world(written, worlds, number))
                share = FITTING_SHARE + (1 - FITTING_SHARE) * row / (2 * half)
                progress(share, f"held-out world {row} of {2 * half}")
            found[WORLDS] = joined(parts)
        if recordings is not None:
            frames = map(loaded, (recordings.calibrate, recordings.judge)[part])
            found["recordings"] = joined([judged_frame(written, worlds, frame) for frame in frames])
        return found

    specs = PillarSpecs(classes=tuple(FoundClass(name=name) for name in CLASSES[worlds]), grid=WRITTEN_GRIDS[worlds])
    out.write_bytes(onnx_bytes(network, specs, GRIDS[worlds]))
    parts = judge_held_out(0)
    if recordings is not None and checkpoint.has_worlds:  # give them as much weight as the worlds
        sweeps = half * SWEEPS_OF_A_WORLD
        parts["recordings"] = joined([parts["recordings"]] * max(sweeps // len(recordings.calibrate), 1))
    found = joined([*parts.values()])
    factor, offset = torch.from_numpy(calibration(found).T.astype(np.float32))
    kinds = slice(len(factor))
    with torch.no_grad():
        network.last.weight[kinds] *= factor[:, None, None, None]
        network.last_bias[kinds] = network.last_bias[kinds] * factor + offset
    specs = specs.model_copy(update={"classes": with_errors(CLASSES[worlds], found)})
    out.write_bytes(onnx_bytes(network, specs, GRIDS[worlds]))
    tables = {name: figures(CLASSES[worlds], one) for name, one in judge_held_out(1).items()}
    return _card(checkpoint, steps, half, tables)


def _card(checkpoint: Checkpoint, steps: int, half: int, tables: Mapping[str, str]) -> str:
    family = f" --family {checkpoint.worlds}" if checkpoint.has_worlds else ""
    recordings = " --recordings RECORDING \\\n     " if checkpoint.recordings else ""
    how = " --bfloat16 \\\n     " if checkpoint.bfloat16 else ""
    sources = "\n".join(f"- from step {step} on {text}" for step, text in checkpoint.load().history)
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
