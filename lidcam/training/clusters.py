"""Training of the network that scores clusters, from worlds to weights and card."""

from collections.abc import Callable, Iterable
from typing import Literal, NamedTuple

from lidcam.bags.simulator.worlds.draw import Family
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.detectors.cluster.network import ClusterNetwork
from lidcam.training.card import PRIORS, figures
from lidcam.training.examples import Examples, examples_of_frame, examples_of_recordings, examples_of_worlds
from lidcam.training.fit import EPOCHS, NETWORKS, calibrated, fitted
from lidcam.training.labelled import WORLDS, Recordings, loaded

FIRST_HELD_OUT = 1_000_000
"""Number of the first world (plus the seed) that is not trained on: some calibrate the network, others judge it."""

HELD_OUT_SHARE = 0.2

CASTING_SHARE = 0.9
"""Share of the time that making the worlds takes."""

Progress = Callable[[float, str], object]
"""Called with the share that is done, and a text to show with it."""


class Trained(NamedTuple):
    """A network and its card in Markdown."""

    network: ClusterNetwork
    card: str


def train_clusters(
    family: Literal["road", "crossing", "all"] | None,
    worlds: int,
    seed: int,
    *,
    workers: int,
    progress: Progress,
    recordings: Recordings | None = None,
) -> Trained:
    """Train on worlds of one or both families, numbered from the seed on, on recordings, or on equal parts of the two.

    Raises:
        RecordingError: no object is labelled in the frames to learn from, or in those to calibrate with.
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
            collect(name, examples_of_worlds(one, numbers, workers=workers))
    judged: list[tuple[str, Examples]] = [(WORLDS, Examples.joined(found["judge"]))] * bool(families)
    if recordings is not None:
        collect("train", examples_of_recordings(recordings, drawn, workers=workers))
        found["calibrate"] += [examples_of_frame(loaded(path)) for path in recordings.calibrate]
        judged.append(("recordings", Examples.joined([examples_of_frame(loaded(path)) for path in recordings.judge])))
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
    return Trained(network, card)
