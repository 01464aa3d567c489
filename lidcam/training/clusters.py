"""Training of the network that scores clusters, from worlds to weights and card."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor, nn

from lidcam.bags.simulator.worlds.draw import Family
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.pipeline.detectors.cluster.network import ClusterNetwork
from lidcam.training.card import PRIORS, figures, log_loss
from lidcam.training.examples import Examples, examples_of, examples_of_frame
from lidcam.training.labelled import FIRST_HELD_OUT, RECORDINGS, WORLDS, Progress, Recordings, loaded

EPOCHS = 20
NETWORKS = 3
HIDDEN = 160, 80
BATCH = 256
RATE = 2e-3
DECAY = 1e-3
DROPOUT = 0.3  # Share of the hidden neurons that each step leaves out (Srivastava et al., 2014)
NOISE = 0.1  # Standard deviation of the noise on each feature, in the feature's own: worlds differ from reality
HELD_OUT_SHARE = 0.2
CASTING_SHARE = 0.9  # Share of the time that making the worlds takes

EpochDone = Callable[[int, float], object]
"""Called after each epoch of each network with the number of epochs done, and its log loss."""


def fitted(examples: Examples, seed: int, epoch_done: EpochDone) -> ClusterNetwork:
    """Networks fitted by AdamW on mini-batches, with noise on the features and dropout; the same for the same seed."""
    mean, deviation = examples.features.mean(0), examples.features.std(0) + 1e-6
    network = ClusterNetwork(mean, deviation, (), ())
    inputs = torch.from_numpy(network.standard(examples.features).astype(np.float32))
    kinds = torch.from_numpy(examples.kinds)
    networks, threads = [], torch.get_num_threads()
    torch.set_num_threads(1)  # in layers as small as these, threads would wait for each other
    try:
        for row in range(NETWORKS):
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(seed * NETWORKS + row)
                networks.append(_fitted_layers(inputs, kinds, row * EPOCHS, epoch_done))
    finally:
        torch.set_num_threads(threads)
    layers = [*zip(*networks, strict=True)]
    return replace(
        network,
        weights=tuple(np.stack([_numbers(one.weight).T for one in layer]) for layer in layers),
        biases=tuple(np.stack([_numbers(one.bias)[None] for one in layer]) for layer in layers),
    )


def _numbers(tensor: Tensor) -> F64:
    return np.asarray(tensor.detach().double().numpy())


def _fitted_layers(inputs: Tensor, kinds: Tensor, epochs_before: int, epoch_done: EpochDone) -> list[nn.Linear]:
    """Layers of one network; the learning rate falls to 0 along a cosine."""
    layers = [nn.Linear(before, after) for before, after in pairwise((len(FEATURES), *HIDDEN, len(KINDS)))]
    for layer in layers:
        nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        nn.init.zeros_(layer.bias)
    hidden = [part for layer in layers[:-1] for part in (layer, nn.ReLU(), nn.Dropout(DROPOUT))]
    network, batches = nn.Sequential(*hidden, layers[-1]), max(len(kinds) // BATCH, 1)
    groups: list[dict[str, Any]] = [
        {"params": [layer.weight for layer in layers]},
        {"params": [layer.bias for layer in layers], "weight_decay": 0.0},
    ]
    optimiser = torch.optim.AdamW(groups, RATE, weight_decay=DECAY, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS * batches)
    loss_of = nn.CrossEntropyLoss(torch.from_numpy(PRIORS.astype(np.float32)))
    for epoch in range(EPOCHS):
        total = 0.0
        for batch in torch.randperm(len(kinds)).tensor_split(batches):
            noisy = inputs[batch] + NOISE * torch.randn(len(batch), inputs.shape[1])
            optimiser.zero_grad()
            loss = loss_of(network(noisy), kinds[batch])
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.item() / batches
        epoch_done(epochs_before + epoch + 1, total)
    return layers


def calibrated(network: ClusterNetwork, examples: Examples) -> ClusterNetwork:
    """The network with log odds divided by the temperature that fits the examples best (Guo et al., 2017)."""

    def loss(temperature: float) -> float:
        return log_loss(_cooled(network, temperature)(examples.features), examples.kinds)

    return _cooled(network, float(minimize_scalar(loss, bounds=(0.3, 3.0), method="bounded").x))


def _cooled(network: ClusterNetwork, temperature: float) -> ClusterNetwork:
    weights, biases = network.weights, network.biases
    return replace(
        network, weights=(*weights[:-1], weights[-1] / temperature), biases=(*biases[:-1], biases[-1] / temperature)
    )


def train_clusters(
    family: Literal["road", "crossing", "all"] | None,
    worlds: int,
    seed: int,
    *,
    workers: int,
    progress: Progress,
    recordings: Recordings | None = None,
) -> tuple[ClusterNetwork, str]:
    """Train on worlds of one or both families, numbered from the seed on, on recordings, or on equal parts of the two.

    Gives the network, and its card in Markdown. Raises RecordingError if no object is labelled in the frames to learn
    from, or in those to calibrate with.
    """
    families: tuple[Family, ...] = () if family is None else ("road", "crossing") if family == "all" else (family,)
    held_out = max(int(worlds * HELD_OUT_SHARE), 2)
    first, middle = FIRST_HELD_OUT + seed, FIRST_HELD_OUT + seed + held_out // 2
    parts = {
        "train": range(seed, seed + worlds),
        "calibrate": range(first, middle),
        "judge": range(middle, first + held_out),
    }
    drawn = range(seed, seed + worlds * max(len(families), 1)) if recordings else range(0)
    total, done = len(families) * (worlds + held_out) + len(drawn), 0
    found: dict[str, list[Examples]] = {name: [] for name in parts}

    def collect(name: str, some: Iterable[Examples]) -> None:
        nonlocal done
        for examples in some:
            found[name].append(examples)
            done += 1
            progress(CASTING_SHARE * done / total, f"world or frames {done} of {total}")

    for name, numbers in parts.items():
        for one in families:
            collect(name, examples_of(one, numbers, workers=workers))
    judged: list[tuple[str, Examples]] = [(WORLDS, Examples.joined(found["judge"]))] * bool(families)
    if recordings is not None:
        collect("train", examples_of(recordings, drawn, workers=workers))
        found["calibrate"] += [examples_of_frame(loaded(path)) for path in recordings.calibrate]
        judged.append((RECORDINGS, Examples.joined([examples_of_frame(loaded(path)) for path in recordings.judge])))
    train, calibrate = Examples.joined(found["train"]), Examples.joined(found["calibrate"])
    for use, examples in (("learn from", train), ("calibrate with", calibrate)):
        if not examples.kinds.any():
            raise RecordingError(
                f"training of clusters: expected labelled objects that clusters find, found none in the frames to "
                f"{use}; give other recordings, or --family for worlds as well"
            )

    def epoch_done(epoch: int, loss: float) -> None:
        count = EPOCHS * NETWORKS
        progress(CASTING_SHARE + (1 - CASTING_SHARE) * epoch / count, f"epoch {epoch} of {count}, loss {loss:.4f}")

    network = calibrated(fitted(train, seed, epoch_done), calibrate)
    options = f" --family {family}" * bool(families) + " --recordings RECORDING \\\n     " * bool(recordings)
    sources = [WORLDS] * bool(families) + ([recordings.text] if recordings else [])
    held = [f"{held_out} other worlds of each family"] * bool(families) + ["the frames kept apart"] * bool(recordings)
    tables = "\n\n".join(f"In {name}:\n\n{figures(network(one.features), one)}" for name, one in judged)
    card = f"""# Weights of the learned score of clusters

    lidcam train clusters{options} --worlds {worlds} --seed {seed} --out FILE.npz

made these weights from {len(train.kinds)} boxes of clusters in:

{chr(10).join(f"- {one}" for one in sources)}

These are {NETWORKS} networks, {EPOCHS} epochs each. Of {" and ".join(held)},
half gave the temperature. In the other half, with {sum(len(one.kinds) for _, one in judged)} boxes:

{tables}

Found and false: boxes of a probability of 0.5 and more. Calibration error: of boxes from 0.05 on. There people,
cyclists and large vehicles count {PRIORS[2]:g}, {PRIORS[3]:g} and {PRIORS[4]:g} times: streets have fewer.
"""
    return network, card
