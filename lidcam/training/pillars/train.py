"""Training of a network in pillars, from worlds to an ONNX file and its card.

Worlds that it was not trained on give the calibration of its scores, its errors and its figures.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize

from lidcam.bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD
from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.overlaps import without_overlaps
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays
from lidcam.pipeline.detectors.log_odds import sigmoid
from lidcam.pipeline.detectors.pillars.decoding import Found
from lidcam.pipeline.detectors.pillars.embedded import existing_network_file
from lidcam.pipeline.detectors.pillars.network import FoundClass, PillarNetwork, PillarSpecs
from lidcam.training.card import average_precision, calibration_error
from lidcam.training.labelled import FIRST_HELD_OUT, RECORDINGS, WORLDS, LabelledFrame, Progress, TrueBoxes, loaded
from lidcam.training.pillars.fit import BATCH, Checkpoint, fitted
from lidcam.training.pillars.network import onnx_bytes, take_weights
from lidcam.training.pillars.scenes import CLASSES, GRIDS, MIN_POINTS, WRITTEN_GRIDS, Worlds, family_of, known_to, scene

SWEEPS_OF_A_WORLD = 4
MAX_HELD_OUT = 80
MIN_LOG_ODDS = -4.0
FITTING_SHARE = 0.98  # Share of the time that the steps take
MIN_RECORDED = 20  # Objects in the frames that calibrate, from which on scores of their class hold in recordings
PRIOR = 1e-3  # Weight of the calibration that changes nothing: a class with few examples stays near it

GATES_M = {"car": 2.0, "pedestrian": 0.6, "cyclist": 0.9, "truck": 2.5, "bus": 2.5}
"""Maximum distance of a right box from its object, which has its class and belongs to no other box."""

SANDBOX_GATE_M = 0.15  # For model cars


class Trained(NamedTuple):
    """A trained network: its card, and what it and the one that it started from find in the data kept apart."""

    card: str  # In Markdown
    before: Mapping[str, "Judged"]  # By source; empty if the weights were random at the start
    after: Mapping[str, "Judged"]


class Judged(NamedTuple):
    """The boxes of all sweeps, and how many objects they should find."""

    log_odds: F64  # (N,)
    classes: I64  # (N,) rows of `CLASSES`
    is_right: Bools  # (N,)
    errors: F64  # (N, 3) errors in x, y and heading of right boxes, metres and radians; NaN for others
    objects: I64  # (C,) number of objects with `MIN_POINTS` points or more within the grid


def judged_world(network: PillarNetwork, worlds: Worlds, number: int) -> Judged:
    """The boxes that a network finds in the world with a number."""
    first, step = number * SWEEPS_PER_WORLD, SWEEPS_PER_WORLD // SWEEPS_OF_A_WORLD
    scenes = (scene(family_of(worlds, number), seed) for seed in range(first, first + SWEEPS_PER_WORLD, step))
    return joined([_judged_sweep(worlds, network(position, MIN_LOG_ODDS), true) for position, true in scenes])


def judged_frame(network: PillarNetwork, worlds: Worlds, frame: LabelledFrame) -> Judged:
    """The boxes that a network finds in the labelled part of a frame."""
    found = network(frame.position, MIN_LOG_ODDS)
    known = frame.is_labelled(found.centers[:, :2])
    return _judged_sweep(worlds, Found._make(one[known] for one in found), known_to(worlds, frame))


def joined(parts: Sequence[Judged]) -> Judged:
    """All boxes of all parts; at least one part is needed."""
    *columns, objects = zip(*parts, strict=True)
    return Judged._make([*(np.concatenate(one) for one in columns), np.sum(objects, axis=0)])


def _judged_sweep(worlds: Worlds, found: Found, true: TrueBoxes) -> Judged:
    kept = without_overlaps(BoxArrays(found.centers, found.sizes, found.yaws))
    found = Found._make(one[kept] for one in found)
    half_m, names = WRITTEN_GRIDS[worlds].half_m, CLASSES[worlds]
    true = true.select(np.flatnonzero((np.abs(true.centers[:, :2]) < half_m).all(1)))
    gates_m = np.array([SANDBOX_GATE_M if worlds == "sandbox" else GATES_M[name] for name in names])
    away_m = np.linalg.norm(found.centers[:, None, :2] - true.centers[:, :2], axis=2)
    away_m[(found.classes[:, None] != true.classes) | (away_m > gates_m[true.classes])] = np.inf
    own = np.full(len(found.classes), -1)
    for box in range(len(own)):  # likelier ones first
        if np.isfinite(away_m[box]).any():
            own[box] = away_m[box].argmin()
            away_m[:, own[box]] = np.inf
    sure = np.append(true.points >= MIN_POINTS, True)
    is_right = own >= 0
    off = np.full((len(own), 3), np.nan)
    off[is_right, :2] = found.centers[is_right, :2] - true.centers[own[is_right], :2]
    off[is_right, 2] = wrap_angle(found.yaws[is_right] - true.yaws[own[is_right]])
    counted = sure[own]
    objects = np.bincount(true.classes[sure[:-1]], minlength=len(names))
    return Judged(found.log_odds[counted], found.classes[counted], is_right[counted], off[counted], objects)


def precision_of(found: Judged) -> float:
    """Average precision over the boxes of all classes together; 0 without objects."""
    return _precision(found.log_odds, found.is_right, int(found.objects.sum()))


def _precision(score: F64, is_right: Bools, objects: int) -> float:
    return average_precision(score, is_right) * float(is_right.sum()) / max(objects, 1) if is_right.any() else 0.0


def calibration(found: Judged) -> F64:
    """(C, 2) factor and offset that turn the log odds of each class into those of a right box (Platt, 1999)."""
    answer = []
    for name in range(len(found.objects)):
        rows = found.classes == name
        odds, sign = found.log_odds[rows], np.where(found.is_right[rows], -1.0, 1.0)

        def loss(values: F64, odds: F64 = odds, sign: F64 = sign) -> float:
            wrong = np.logaddexp(0, sign * (np.exp(values[0]) * odds + values[1]))
            return float(wrong.sum() / max(len(odds), 1) + PRIOR * (values**2).sum())

        log_factor, offset = minimize(loss, np.zeros(2)).x
        answer.append((np.exp(log_factor), offset))
    return np.array(answer)


def with_errors(classes: Sequence[str], found: Judged, recorded: I64) -> tuple[FoundClass, ...]:
    """Classes with the standard deviations of right boxes; swapped front and rear is no error of heading.

    `recorded` (C,) are the numbers of objects in recordings by which their scores were calibrated.
    """
    made = []
    for row, name in enumerate(classes):
        errors, sigmas = found.errors[(found.classes == row) & found.is_right], {}
        if len(errors) > 1:
            sigmas = {"sigma_m": errors[:, :2], "sigma_rad": _not_turned(errors[:, 2])}
        rms = {key: max(round(float(np.sqrt((one**2).mean())), 4), 1e-4) for key, one in sigmas.items()}
        made.append(FoundClass(name=name, recorded=bool(recorded[row] >= MIN_RECORDED), **rms))
    return tuple(made)


def _not_turned(yaw_errors: F64) -> F64:
    return np.asarray((yaw_errors + np.pi / 2) % np.pi - np.pi / 2)


def figures(classes: Sequence[str], found: Judged) -> str:
    """A Markdown table with a row for each class, for boxes whose scores are calibrated."""
    lines = [
        "| class | objects | found | false | AP | ECE | position | heading | turned |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row, name in enumerate(classes):
        rows = found.classes == row
        score, is_right = sigmoid(found.log_odds[rows]), found.is_right[rows]
        taken, objects = score >= 0.5, int(found.objects[row])
        errors = found.errors[rows][taken & is_right]
        cells = [f"{objects}", f"{(taken & is_right).sum()}", f"{(taken & ~is_right).sum()}"]
        ece = calibration_error(score, is_right, np.ones(len(score)))
        cells += [f"{_precision(score, is_right, objects):.3f}", f"{ece:.3f}"]
        if len(errors):
            cells.append(f"{np.median(np.hypot(errors[:, 0], errors[:, 1])):.3f} m")
            cells.append(f"{np.rad2deg(np.median(np.abs(_not_turned(errors[:, 2])))):.1f} deg")
            cells.append(f"{(np.abs(errors[:, 2]) > np.pi / 2).mean():.0%}")
        else:
            cells += ["--"] * 3
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def train_pillars(
    checkpoint: Checkpoint,
    out: Path,
    steps: int,
    *,
    workers: int,
    progress: Progress,
    kept_share: float = 0.0,
    begun: Callable[[Mapping[str, Judged]], object] = lambda _: None,
) -> Trained:
    """Train a network, or continue from its checkpoint, write it as an ONNX file, and judge it.

    Args and Raises: as for `fitted`; others:
        kept_share: Share of the weights of the network that it starts from in those that are written. A mean of both
            keeps what the start knew of other places (Wortsman et al., "Robust fine-tuning of zero-shot models", 2022).
        begun: Called before the first step with what the network that it starts from finds in the data kept apart.
    """
    if checkpoint.path.exists():
        checkpoint = checkpoint._replace(begin=checkpoint.load().begin)
    (worlds, recordings, has_worlds), seed = checkpoint.source, checkpoint.seed

    def step_done(step: int, loss: float) -> None:
        progress(FITTING_SHARE * step / steps, f"step {step} of {steps}, loss {loss:.3f}")

    half = min(max(steps // 100, 1), MAX_HELD_OUT // 2)

    def judge_held_out(part: int, network: Path = out) -> dict[str, Judged]:
        """Boxes in the data kept apart, by source; part 0 calibrates, part 1 judges."""
        written, found = PillarNetwork(network), {}
        if has_worlds:
            first, parts = FIRST_HELD_OUT + seed + part * half, []
            for row, number in enumerate(range(first, first + half), part * half + 1):
                parts.append(judged_world(written, worlds, number))
                if network == out:
                    share = FITTING_SHARE + (1 - FITTING_SHARE) * row / (2 * half)
                    progress(share, f"held-out world {row} of {2 * half}")
            found[WORLDS] = joined(parts)
        if recordings is not None:
            frames = map(loaded, (recordings.calibrate, recordings.judge)[part])
            found[RECORDINGS] = joined([judged_frame(written, worlds, frame) for frame in frames])
        return found

    begin = existing_network_file(Path(checkpoint.begin)) if checkpoint.begin else None
    before = judge_held_out(1, begin) if begin else {}
    begun(before)
    network = fitted(checkpoint, steps, workers=workers, step_done=step_done)
    if begin and kept_share:
        take_weights(network, begin, CLASSES[worlds], GRIDS[worlds], kept_share)
    specs = PillarSpecs(classes=tuple(FoundClass(name=name) for name in CLASSES[worlds]), grid=WRITTEN_GRIDS[worlds])
    out.write_bytes(onnx_bytes(network, specs, GRIDS[worlds]))
    parts, recorded = judge_held_out(0), np.zeros(len(specs.classes), np.int64)
    if recordings is not None:
        recorded = parts[RECORDINGS].objects
    if recordings is not None and has_worlds:  # give them as much weight as the worlds
        sweeps = half * SWEEPS_OF_A_WORLD
        parts[RECORDINGS] = joined([parts[RECORDINGS]] * max(sweeps // len(recordings.calibrate), 1))
    found = joined([*parts.values()])
    factor, offset = torch.from_numpy(calibration(found).T.astype(np.float32))
    kinds = slice(len(factor))
    with torch.no_grad():
        network.last.weight[kinds] *= factor[:, None, None, None]
        network.last.bias[kinds] = network.last.bias[kinds] * factor + offset
    specs = specs.model_copy(update={"classes": with_errors(CLASSES[worlds], found, recorded)})
    out.write_bytes(onnx_bytes(network, specs, GRIDS[worlds]))
    after = judge_held_out(1)
    return Trained(_card(checkpoint, steps, half, before, after), before, after)


def _card(
    checkpoint: Checkpoint, steps: int, half: int, before: Mapping[str, Judged], after: Mapping[str, Judged]
) -> str:
    family = f" --family {checkpoint.source.worlds}" if checkpoint.source.has_worlds else ""
    recordings = " --recordings RECORDING \\\n     " if checkpoint.source.recordings else ""
    how = " --bfloat16 \\\n     " if checkpoint.bfloat16 else ""
    sources = "\n".join(f"- from step {step} on {text}" for step, text in checkpoint.load().history)
    classes = CLASSES[checkpoint.source.worlds]
    table = "\n\n".join(f"In {name}:\n\n{figures(classes, found)}" for name, found in after.items())
    first = Path(checkpoint.begin).name
    table += "".join(f"\n\n`{first}` in {name}:\n\n{figures(classes, found)}" for name, found in before.items())
    apart = [f"{2 * half} other worlds"] * checkpoint.source.has_worlds + ["the frames kept apart"] * bool(recordings)
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
