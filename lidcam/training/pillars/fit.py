"""A network fitted to scenes that are made during the training, from a checkpoint if there is one."""

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.settings.model import SettingsModel
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.detectors.pillars.embedded import existing_network_file
from lidcam.training.pillars.network import PillarNetwork, take_weights
from lidcam.training.pillars.scenes import CLASSES, GRIDS, SCENES_OF_A_ROUND, Scene, Source, Worlds, rounds
from lidcam.training.torch_file import torch_file
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.transaction import OutputTransaction

BATCH = 4
DECAY = 1e-2
WARM_STEPS = 100
MAX_RATE = 2e-3
MAX_RATE_ONWARD = 5e-4  # For a training that starts from the weights of another network
MAX_GRADIENT = 10.0
MOMENTUM = 0.99  # Of the running mean of the loss that is shown
CHECKPOINT_EVERY_S = 60.0

StepDone = Callable[[int, float], object]
"""Called after each step with the number of steps done, and the recent mean loss."""


class State(SettingsModel):
    """The saved state of a training."""

    network: dict[str, Any]
    optimiser: dict[str, Any]
    step: Annotated[int, Field(ge=0)]  # Number of steps done
    loss: float  # Recent mean loss
    history: list[tuple[int, str]]  # Steps, and the `text` of the training since each of them
    family: Worlds
    seed: int
    begin: str  # As in `Checkpoint`


class Checkpoint(NamedTuple):
    """File with the state of a training, and which training it is."""

    path: Path  # The file, which is complete at any time
    source: Source  # Source of the scenes; the saved state may have another one with the same grid and classes
    seed: int  # Number of the first world
    # Network of `lidcam train pillars` to start from: a name of `EMBEDDED` or a path; empty: random weights
    begin: str = ""
    bfloat16: bool = False  # Whether the network computes in bfloat16, which halves the time on processors that have it

    @property
    def text(self) -> str:
        """Source of the scenes and precision, in Markdown."""
        return self.source.text + ", in bfloat16" * self.bfloat16

    def save(
        self,
        network: nn.Module,
        optimiser: torch.optim.Optimizer,
        step: int,
        loss: float,
        history: Sequence[tuple[int, str]] = (),
    ) -> None:
        """Replace the file, or raise OutputError; `history` lists steps, and the `text` of the training since each."""
        state = {"network": network.state_dict(), "optimiser": optimiser.state_dict(), "step": step, "loss": loss}
        state |= {"history": [*history], "family": self.source.worlds, "seed": self.seed, "begin": self.begin}
        with (
            OutputTransaction([self.path]) as outputs,
            output_errors(self.path),
            outputs[self.path].part.open("xb") as file,
        ):
            torch.save(state, file)

    def load(self, *into: PillarNetwork | torch.optim.Optimizer) -> State:
        """Read the saved state, and put it into the network and the optimiser, if these are given.

        Raises LidcamError if the file cannot be read, or belongs to another training.
        """
        expected = f"{self.path}: expected the state of a training of --family {self.source.worlds} --seed {self.seed}"
        try:
            with torch_file(self.path) as file:
                state = State.model_validate(torch.load(file, map_location="cpu", weights_only=True))
            known = state.family
            facts = GRIDS[known], CLASSES[known], state.seed
            is_same = facts == (GRIDS[self.source.worlds], CLASSES[self.source.worlds], self.seed)
            for one, saved in zip(into if is_same else (), (state.network, state.optimiser), strict=False):
                one.load_state_dict(saved)
        except Exception as err:  # errors of pickled files share no base class
            raise LidcamError(f"{expected}, found {one_line(err, max_characters=200)}") from err
        if not is_same:
            raise LidcamError(f"{expected}, found --family {known} --seed {state.seed}")
        return state


def fitted(
    checkpoint: Checkpoint, steps: int, *, workers: int, step_done: StepDone, every_s: float = CHECKPOINT_EVERY_S
) -> PillarNetwork:
    """Train a network up to a number of steps, on the first CUDA device if there is one.

    On a processor, the same seed and number of threads give the same network, even if the training was interrupted.

    Args:
        checkpoint: State of the training; if its file exists, the training continues from it.
        steps: Number of steps in all.
        workers: Processes that make scenes.
        step_done: Called after each step.
        every_s: Wall time between checkpoints.

    Raises:
        LidcamError: the checkpoint cannot be used.
        OutputError: it cannot be written.
    """
    seed, classes = checkpoint.seed, CLASSES[checkpoint.source.worlds]
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = PillarNetwork(len(classes))
    network.to(device)
    optimiser = torch.optim.AdamW(network.parameters(), MAX_RATE, weight_decay=DECAY)
    step, mean_loss, history = 0, float("nan"), []
    if checkpoint.path.exists():
        state = checkpoint.load(network, optimiser)
        step, mean_loss, history = state.step, state.loss, state.history
        if step > steps:
            raise LidcamError(f"{checkpoint.path}: is already at step {step}; pass --steps {step} or more")
    elif checkpoint.begin:
        take_weights(network, existing_network_file(Path(checkpoint.begin)), classes, GRIDS[checkpoint.source.worlds])
        history.append((0, f"with the weights of `{Path(checkpoint.begin).name}`"))
    if not history or history[-1][1] != checkpoint.text:
        history.append((step, checkpoint.text))
    max_rate = MAX_RATE_ONWARD if checkpoint.begin else MAX_RATE
    saved_s = time.monotonic()
    network.train()
    with closing(_batches(checkpoint.source, seed, step, steps, workers)) as batches:
        for batch in batches:
            # A short rise, then a fall along a cosine.
            share = min((step + 1) / WARM_STEPS, 1.0) * (0.5 + 0.5 * float(np.cos(np.pi * step / steps)))
            optimiser.param_groups[0]["lr"] = max_rate * share
            optimiser.zero_grad()
            loss = _loss(network, batch, checkpoint.bfloat16, device)
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT)
            optimiser.step()
            step += 1
            mean_loss = loss.item() if step == 1 else MOMENTUM * mean_loss + (1 - MOMENTUM) * loss.item()
            if step == steps or time.monotonic() - saved_s >= every_s:
                checkpoint.save(network, optimiser, step, mean_loss, history)
                saved_s = time.monotonic()
            step_done(step, mean_loss)
    return network


def _batches(source: Source, seed: int, step: int, steps: int, workers: int) -> Generator[list[Scene]]:
    """The batches of the steps from `step` up to `steps`."""
    per_round = SCENES_OF_A_ROUND // BATCH
    first, last = step // per_round, -(-steps // per_round)
    with closing(rounds(source, seed, first, last, workers)) as scenes:
        all_batches = (found[row : row + BATCH] for found in scenes for row in range(0, SCENES_OF_A_ROUND, BATCH))
        yield from islice(all_batches, step - first * per_round, steps - first * per_round)


def _loss(network: PillarNetwork, batch: list[Scene], bfloat16: bool, device: torch.device) -> Tensor:
    """Focal loss of the centres (Zhou, Wang, Kraehenbuehl, "Objects as points", 2019), and L1 of the boxes."""
    targets = [scene.targets for scene in batch]
    classes, side = targets[0].heat.shape[0], targets[0].heat.shape[1]
    cells = 2 * side
    pillar = np.concatenate([scene.pillar + row * cells * cells for row, scene in enumerate(batch)])
    features = np.concatenate([scene.features for scene in batch])
    output = network(_on(features, device), _on(pillar, device), len(batch), cells, bfloat16=bfloat16)
    heat, odds = _on(np.stack([one.heat for one in targets]), device), output[:, :classes]
    log_is, log_not = nn.functional.logsigmoid(odds), nn.functional.logsigmoid(-odds)
    is_center = heat == 1
    at_center = torch.where(is_center, log_not.exp() ** 2 * log_is, torch.zeros_like(odds)).sum()
    beside = torch.where(is_center, torch.zeros_like(odds), (1 - heat) ** 4 * log_is.exp() ** 2 * log_not).sum()
    count = is_center.sum().clamp(min=1)
    place = np.concatenate([one.cells + row * side * side for row, one in enumerate(targets)])
    numbers = output[:, classes:].permute(0, 2, 3, 1).reshape(-1, output.shape[1] - classes)[_on(place, device)]
    weights = _on(np.concatenate([one.weights for one in targets]), device)
    away = (numbers - _on(np.concatenate([one.numbers for one in targets]), device)).abs().sum(1)
    return cast(Tensor, -(at_center + beside) / count + (weights * away).sum() / weights.sum().clamp(min=1))


def _on(array: Any, device: torch.device) -> Tensor:
    return torch.from_numpy(array).to(device)
