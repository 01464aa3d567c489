"""Training of the network that scores clusters, from worlds to weights and card."""

from collections.abc import Callable
from typing import Literal, NamedTuple

from bags.simulator.worlds.draw import Family
from lidcam.training.card import figures
from lidcam.training.examples import Examples, examples_of_worlds
from lidcam.training.fit import EPOCHS, NETWORKS, PRIORS, calibrated, fitted
from pipeline.detectors.cluster.network import ClusterNetwork

__all__ = ["Trained", "train_clusters"]

HELD_OUT = 1_000_000
"""Worlds from this number on, added to the seed, are not trained on: some calibrate the network, others judge it."""

HELD_OUT_SHARE = 0.2

Told = Callable[[float, str], object]
"""Called with the share that is done, and what to say beside."""

CASTING = 0.9
"""Share of the time that worlds take."""


class Trained(NamedTuple):
    """A network and its card in Markdown."""

    network: ClusterNetwork
    card: str


def train_clusters(
    family: Literal["road", "crossing", "all"], worlds: int, seed: int, *, workers: int, told: Told
) -> Trained:
    """Train on worlds of a family, or of both, numbered from the seed on, and judge by others."""
    families: tuple[Family, ...] = ("road", "crossing") if family == "all" else (family,)
    held_out = max(int(worlds * HELD_OUT_SHARE), 2)
    parts = {"train": range(seed, seed + worlds), "calibrate": range(HELD_OUT + seed, HELD_OUT + seed + held_out // 2)}
    parts["judge"] = range(HELD_OUT + seed + held_out // 2, HELD_OUT + seed + held_out)
    total, done = len(families) * (worlds + held_out), 0
    found: dict[str, list[Examples]] = {name: [] for name in parts}
    for name, numbers in parts.items():
        for one in families:
            for examples in examples_of_worlds(one, numbers, workers=workers):
                found[name].append(examples)
                done += 1
                told(CASTING * done / total, f"world {done} of {total}")
    train, calibrate, judge = (Examples.joined(found[name]) for name in parts)

    def fitting(epoch: int, loss: float) -> None:
        of = EPOCHS * NETWORKS
        told(CASTING + (1 - CASTING) * epoch / of, f"epoch {epoch} of {of}, loss {loss:.4f}")

    network = calibrated(fitted(train, seed, fitting), calibrate)
    command = f"lidcam train clusters --family {family} --worlds {worlds} --seed {seed} --out FILE.npz"
    return Trained(network, _card(command, network, train, judge, held_out))


def _card(command: str, network: ClusterNetwork, train: Examples, judge: Examples, held_out: int) -> str:
    return f"""# Weights of the learned score of clusters

    {command}

made these weights from {len(train.kinds)} boxes of clusters in drawn worlds, and no recording: {NETWORKS} networks,
{EPOCHS} epochs each. Of {held_out} other worlds of each family, half gave the temperature. In the other half, with
{len(judge.kinds)} boxes:

{figures(network(judge.features), judge)}

Found and false: boxes of a probability of 0.5 and more. Calibration error: of boxes from 0.05 on. There people,
cyclists and large vehicles count {PRIORS[2]:g}, {PRIORS[3]:g} and {PRIORS[4]:g} times: streets have fewer.
"""
