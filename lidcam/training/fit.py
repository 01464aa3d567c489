"""Networks fitted to examples: AdamW on mini-batches, with noise on the features and dropout."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor, nn

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.pipeline.detectors.cluster.network import ClusterNetwork
from lidcam.training.card import PRIORS, log_loss
from lidcam.training.examples import Examples

EPOCHS = 20
NETWORKS = 3
HIDDEN = 96, 48
BATCH = 256
RATE = 2e-3
DECAY = 1e-3

DROPOUT = 0.3
"""Share of the hidden neurons that each step leaves out (Srivastava et al., 2014)."""

NOISE = 0.2
"""Standard deviation of the noise on each feature, as a share of the feature's own: worlds differ from reality."""

EpochDone = Callable[[int, float], object]
"""Called after each epoch of each network with the number of epochs done, and its log loss."""


def fitted(examples: Examples, seed: int, epoch_done: EpochDone) -> ClusterNetwork:
    """Networks fitted to examples; the same for the same seed."""
    mean, deviation = examples.features.mean(0), examples.features.std(0) + 1e-6
    network = ClusterNetwork(mean, deviation, (), ())
    inputs = torch.from_numpy(network.standard(examples.features).astype(np.float32))
    kinds = torch.from_numpy(examples.kinds)
    torch.set_num_threads(1)  # in layers as small as these, threads would wait for each other
    networks = []
    for row in range(NETWORKS):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed * NETWORKS + row)
            networks.append(_fitted_layers(inputs, kinds, row * EPOCHS, epoch_done))
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
        network,
        weights=(*weights[:-1], weights[-1] / temperature),
        biases=(*biases[:-1], biases[-1] / temperature),
    )
