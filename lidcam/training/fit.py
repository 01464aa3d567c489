"""Networks fitted to examples: Adam on mini-batches, with noise on the features and dropout."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize_scalar

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.pipeline.detectors.cluster.network import ClusterNetwork, softmax
from lidcam.training.examples import Examples

EPOCHS = 20
NETWORKS = 3
HIDDEN = 96, 48
BATCH = 256
RATE, MOMENTUM, SQUARES = 2e-3, 0.9, 0.999
DECAY = 1e-3
DROPPED = 0.3
"""Share of the hidden neurons that each step leaves out (Srivastava et al., 2014)."""

NOISE = 0.2
"""Standard deviation of the noise on each feature, as a share of the feature's own: worlds differ from reality."""

PRIORS = np.array([1.0, 1.0, 0.4, 0.4, 0.6])
"""Weight of an example of each of `KINDS`. Worlds have more people, cyclists and large vehicles than streets, so that
there are enough to learn from; these weights make them count as often as in streets."""

Told = Callable[[int, float], object]
"""Called after each epoch of each network with the number of epochs done, and the log loss in this one."""


def fitted(examples: Examples, seed: int, told: Told) -> ClusterNetwork:
    """Networks fitted to examples; the same for the same seed."""
    mean, deviation = examples.features.mean(0), examples.features.std(0) + 1e-6
    network = ClusterNetwork(mean, deviation, (), ())
    inputs, shapes = network.standard(examples.features), list(pairwise((len(FEATURES), *HIDDEN, len(KINDS))))
    layers, biases = [], []
    for row in range(NETWORKS):
        draw = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, row])))
        layers.append([draw.normal(0, np.sqrt(2 / shape[0]), shape) for shape in shapes])
        biases.append([np.zeros(shape[1]) for shape in shapes])
        told_more = partial(_told_after, told, row * EPOCHS)
        _fit(layers[-1], biases[-1], inputs, examples.kinds, draw, told_more)
    return replace(
        network,
        weights=tuple(np.stack(parts) for parts in zip(*layers, strict=True)),
        biases=tuple(np.stack(parts)[:, None] for parts in zip(*biases, strict=True)),
    )


def _told_after(told: Told, before: int, done: int, loss: float) -> None:
    told(before + done, loss)


def _fit(weights: list[F64], biases: list[F64], inputs: F64, kinds: I64, draw: np.random.Generator, told: Told) -> None:
    """Fit one network, in place (Kingma and Ba, 2015); the rate falls to 0 along a cosine."""
    values = [*weights, *biases]
    means, squares = [np.zeros_like(value) for value in values], [np.zeros_like(value) for value in values]
    share, batches, step = PRIORS[kinds], max(len(kinds) // BATCH, 1), 0
    for epoch in range(EPOCHS):
        order, loss = draw.permutation(len(kinds)), 0.0
        for batch in np.array_split(order, batches):
            step += 1
            noisy = inputs[batch] + NOISE * draw.standard_normal((len(batch), inputs.shape[1]))
            value, slopes = _slopes(weights, biases, noisy, kinds[batch], share[batch], draw)
            loss += value / batches
            rate = RATE / 2 * (1 + np.cos(np.pi * step / (EPOCHS * batches)))
            for row, slope in enumerate(slopes):
                means[row] += (1 - MOMENTUM) * (slope - means[row])
                squares[row] += (1 - SQUARES) * (slope**2 - squares[row])
                moved = means[row] / (1 - MOMENTUM**step) / (np.sqrt(squares[row] / (1 - SQUARES**step)) + 1e-8)
                values[row] -= rate * (moved + DECAY * values[row] * (row < len(weights)))
        told(epoch + 1, loss)


def _slopes(
    weights: list[F64], biases: list[F64], inputs: F64, kinds: I64, share: F64, draw: np.random.Generator
) -> tuple[float, list[F64]]:
    """Log loss of a batch, and its gradients for all weights and then all biases."""
    layers = [inputs]
    for row, (layer, bias) in enumerate(zip(weights, biases, strict=True)):
        value = layers[-1] @ layer + bias
        if row < len(weights) - 1:
            kept = (draw.random(value.shape) >= DROPPED) / (1 - DROPPED)
            value = np.maximum(value, 0.0) * kept
        layers.append(value)
    found, rows = softmax(layers[-1]), np.arange(len(kinds))
    loss = float(-(share * np.log(np.maximum(found[rows, kinds], 1e-12))).sum() / share.sum())
    slope = found.copy()
    slope[rows, kinds] -= 1.0
    slope *= (share / share.sum())[:, None]
    of_weights, of_biases = [], []
    for row in range(len(weights) - 1, -1, -1):
        of_weights.append(layers[row].T @ slope)
        of_biases.append(slope.sum(0))
        if row:
            slope = (slope @ weights[row].T) * (layers[row] > 0) / (1 - DROPPED)
    return loss, of_weights[::-1] + of_biases[::-1]


def calibrated(network: ClusterNetwork, examples: Examples) -> ClusterNetwork:
    """The network with log odds divided by the temperature that fits the examples best (Guo et al., 2017)."""

    def loss(temperature: float) -> float:
        return log_loss(_cooled(network, temperature)(examples.features), examples.kinds)

    return _cooled(network, float(minimize_scalar(loss, bounds=(0.3, 3.0), method="bounded").x))


def _cooled(network: ClusterNetwork, temperature: float) -> ClusterNetwork:
    last = network.weights[-1] / temperature, network.biases[-1] / temperature
    return replace(network, weights=(*network.weights[:-1], last[0]), biases=(*network.biases[:-1], last[1]))


def log_loss(probabilities: F64, kinds: I64) -> float:
    """Mean negative logarithm of the probability of the true kind, weighted by `PRIORS`.

    Args:
        probabilities: (N, 5) probability of each kind.
        kinds: (N,) true kinds.
    """
    true, share = probabilities[np.arange(len(kinds)), kinds], PRIORS[kinds]
    return float(-(share * np.log(np.maximum(true, 1e-12))).sum() / share.sum())
