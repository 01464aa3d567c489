"""Training of a network for simulated images, from worlds to an ONNX file and its card."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.geometry.boxes import iou_xyxy
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.log_odds import logit
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D
from lidcam.pipeline.detectors.onnx.layouts.cells import cells_of
from lidcam.pipeline.stages.detect2d import NMS_IOU, suppress_overlaps
from lidcam.training.card import average_precision
from lidcam.training.images.network import ImageNetwork
from lidcam.training.images.onnx_file import onnx_bytes
from lidcam.training.images.pictures import (
    CLASSES,
    CUTS_OF_A_ROUND,
    WORLDS_OF_A_ROUND,
    Cut,
    Picture,
    cuts,
    pictures,
)
from lidcam.training.pillars.judging import Judged, calibration

BATCH = 8
RATE, DECAY, WARM_STEPS = 3e-3, 1e-2, 100
MAX_GRADIENT = 10.0
MOMENTUM = 0.99
"""Momentum of the running mean of the loss that is shown."""

MAX_LOG_SIZE = 5.0
"""Limit on the logarithm of a box's size in cells: early in training, exponentials may take any value."""

HELD_OUT = 1_000_000
"""Worlds from this number (plus the seed) on judge the network and do not train it."""

MAX_HELD_OUT = 30
FITTING = 0.95
"""Share of the time that the steps take."""

MIN_IOU = 0.5
LEAST_SCORE = 0.02
"""Least score of the boxes that show how likely a box with a given score is right."""

Told = Callable[[float, str], object]
"""Called with the share that is done, and a text to show with it."""


def train_images(out: Path, steps: int, seed: int, *, told: Told) -> str:
    """Train a network, write it as an ONNX file, and return its card in Markdown.

    Args:
        out: File to write.
        steps: Number of steps.
        seed: Number of the first world.
        told: Told of progress.
    """
    network = fitted(
        seed, steps, lambda step, loss: told(FITTING * step / steps, f"step {step} of {steps}, loss {loss:.3f}")
    )
    return judge(network, out, steps, seed, told=told)


def judge(network: ImageNetwork, out: Path, steps: int, seed: int, *, told: Told) -> str:
    """Write a network whose scores are calibrated on some worlds; return its card, with figures from other worlds."""
    half = min(max(steps // 100, 1), MAX_HELD_OUT // 2)

    def seen(first: int) -> Iterator[_Judged]:
        out.write_bytes(onnx_bytes(network, CLASSES))
        detector = OnnxDetector2D(out, Detect2DConfig(min_score=LEAST_SCORE))
        for row in range(first, first + half):
            yield from (_judged(detector, picture) for picture in pictures(HELD_OUT + seed + row))
            told(FITTING + (1 - FITTING) * (row + 1) / (2 * half), f"held-out world {row + 1} of {2 * half}")

    found = _joined(seen(0))
    odds, as_one = logit(found.scores), np.zeros(len(found.scores), np.int64)
    factor, offset = calibration(Judged(odds, as_one, found.is_right, np.empty((0, 3)), np.zeros(1, np.int64)))[0]
    heads: list[Any] = [*network.heads]
    with torch.no_grad():
        for *_, last in heads:
            last.weight[4] *= factor
            last.bias[4] = last.bias[4] * factor + offset
    return _card(steps, seed, 2 * half, _figures(_joined(seen(half))))


def fitted(seed: int, steps: int, told: Callable[[int, float], object]) -> ImageNetwork:
    """Train a network for so many steps on one thread; the same seed gives the same network.

    Args:
        seed: Number of the first world.
        steps: Number of steps.
        told: Called after each step with the number of steps done, and the recent mean loss.
    """
    torch.set_num_threads(1)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = ImageNetwork(len(CLASSES))
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # faster; torch's types lack it
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    learned, mean_loss = cuts(seed), float("nan")
    for step in range(steps):
        rate = RATE * min((step + 1) / WARM_STEPS, 1.0) * (0.5 + 0.5 * float(np.cos(np.pi * step / steps)))
        for group in optimiser.param_groups:
            group["lr"] = rate
        optimiser.zero_grad()
        loss = loss_of(network, [*islice(learned, BATCH)])
        loss.backward()  # type: ignore[no-untyped-call]  # torch has no types for it
        nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT)
        optimiser.step()
        mean_loss = MOMENTUM * mean_loss + (1 - MOMENTUM) * loss.item() if step else loss.item()
        told(step + 1, mean_loss)
    return network.eval()


def loss_of(network: Callable[[Tensor], Tensor], batch: Sequence[Cut]) -> Tensor:
    """Focal loss of the centres (Zhou, Wang, Kraehenbuehl, 2019), generalised IoU of boxes, entropy of classes."""
    output = network(torch.from_numpy(np.stack([cut.image for cut in batch])))
    heat, odds = torch.from_numpy(np.stack([cut.heat for cut in batch])), output[..., 4]
    log_is, log_not = nn.functional.logsigmoid(odds), nn.functional.logsigmoid(-odds)
    is_center = heat == 1
    at_center = (log_not.exp() ** 2 * log_is)[is_center].sum()
    beside = ((1 - heat) ** 4 * log_is.exp() ** 2 * log_not)[~is_center].sum()
    rows = torch.from_numpy(np.concatenate([row * heat.shape[1] + cut.cells for row, cut in enumerate(batch)]))
    grid, stride_px = (torch.from_numpy(cells) for cells in cells_of(batch[0].image.shape[1:]))
    numbers, weights = output.reshape(-1, output.shape[2])[rows], heat.reshape(-1)[rows]
    at, size = rows % heat.shape[1], numbers[:, 2:4].clamp(max=MAX_LOG_SIZE).exp()
    middle = numbers[:, :2] + grid[at]
    boxes = torch.cat([middle - size / 2, middle + size / 2], 1) * stride_px[at]
    true = torch.from_numpy(np.concatenate([cut.xyxy for cut in batch]))
    classes = torch.from_numpy(np.concatenate([cut.classes for cut in batch]))
    wrong = 2 * (1 - _generalised_iou(boxes, true))
    wrong = wrong + nn.functional.cross_entropy(numbers[:, 5:], classes, reduction="none")
    return -(at_center + beside) / is_center.sum().clamp(min=1) + (weights * wrong).sum() / weights.sum().clamp(min=1)


def _generalised_iou(first: Tensor, second: Tensor) -> Tensor:
    """Like `pair_overlaps_xyxy`, but for training."""

    def area(low: Tensor, high: Tensor) -> Tensor:
        return (high - low).clamp(min=0).prod(1)

    low, high, other_low, other_high = first[:, :2], first[:, 2:], second[:, :2], second[:, 2:]
    shared = area(torch.maximum(low, other_low), torch.minimum(high, other_high))
    filled = area(low, high) + area(other_low, other_high) - shared
    around = area(torch.minimum(low, other_low), torch.maximum(high, other_high))
    return shared / filled - (around - filled) / around


class _Judged(NamedTuple):
    """Boxes found in images (N,), and the classes of the objects that have to be found (M,)."""

    scores: F64
    classes: I64
    is_right: Bools
    objects: I64


def _judged(detector: OnnxDetector2D, picture: Picture) -> _Judged:
    proposed = detector([picture.rgb])[0]
    boxes = Boxes2D(0, "", proposed.xyxy, proposed.scores, proposed.labels.astype(np.int32))
    boxes = boxes.select(suppress_overlaps(boxes, max_iou=NMS_IOU))
    overlap = iou_xyxy(boxes.xyxy, picture.xyxy)
    overlap[(overlap < MIN_IOU) | (boxes.class_ids[:, None] != picture.classes)] = 0
    own = np.full(len(overlap), -1)
    for box in range(len(overlap)):  # likelier ones first
        if overlap[box].any():
            own[box] = overlap[box].argmax()
            overlap[:, own[box]] = 0
    counted = np.append(picture.is_sure, True)[own]
    kinds, objects = boxes.class_ids.astype(np.int64)[counted], picture.classes[picture.is_sure]
    return _Judged(boxes.scores.astype(np.float64)[counted], kinds, own[counted] >= 0, objects)


def _joined(judged: Iterable[_Judged]) -> _Judged:
    return _Judged._make(np.concatenate(column) for column in zip(*judged, strict=True))


def _figures(found: _Judged) -> str:
    """The figures as a Markdown table."""
    lines = ["| class | objects | found | false | AP |", "| --- | --- | --- | --- | --- |"]
    for row, name in enumerate(CLASSES):
        rows, count = found.classes == row, int((found.objects == row).sum())
        is_right, taken = found.is_right[rows], found.scores[rows] >= 0.5
        precision = average_precision(found.scores[rows], is_right) * is_right.sum() / max(count, 1)
        numbers = f"{count} | {(taken & is_right).sum()} | {(taken & ~is_right).sum()}"
        lines.append(f"| {name} | {numbers} | {np.nan_to_num(precision):.3f} |")
    return "\n".join(lines)


def _card(steps: int, seed: int, held_out: int, table: str) -> str:
    worlds = -(-steps * BATCH // CUTS_OF_A_ROUND) * WORLDS_OF_A_ROUND
    return f"""# A 2D network for simulated images

    lidcam train images --steps {steps} --seed {seed} --out FILE.onnx

made this network from {steps * BATCH} parts of images of {worlds} drawn worlds, and
no recording. It knows what the simulator draws: in real images it is of no use.
Of {held_out} other worlds, half made its scores about probabilities. In images of the
other half, of objects of which 30 % and 12 rows of pixels and more are seen:

{table}

Found and false: boxes of a score of 0.5 and more. AP: average precision. A box
is right if its IoU with an object of its class is 0.5 or more.

    lidcam-process drive.mcap out.mcap --model-2d FILE.onnx
"""
