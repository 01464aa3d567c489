"""`lidcam train pillars`: a few steps of it, which teach nothing and show that all of it works."""

# ruff: noqa: E402  # without torch the file is skipped before it imports what needs it

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from command import called
from helpers import SANDBOX
from pillar_files import write_pillars

torch = pytest.importorskip("torch", reason="needs the extra train")

import lidcam
from lidcam.bags.simulator.worlds.draw import random_numbers_of
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.detectors.pillars.decoding import BOX_NUMBERS, boxes_of
from lidcam.pipeline.detectors.pillars.embedded import EMBEDDED
from lidcam.pipeline.detectors.pillars.grid import FEATURES, pillars
from lidcam.pipeline.detectors.pillars.network import FoundClass, PillarNetwork, PillarSpecs
from lidcam.training.labelled import Recordings, TrueBoxes
from lidcam.training.pillars import fit, train
from lidcam.training.pillars import network as torch_network
from lidcam.training.pillars.fit import Checkpoint, fitted
from lidcam.training.pillars.network import onnx_bytes, take_weights
from lidcam.training.pillars.scenes import (
    CLASSES,
    GRIDS,
    SCENES_OF_A_ROUND,
    Scene,
    Source,
    Targets,
    Worlds,
    family_of,
    targets_of,
)
from lidcam.training.pillars.train import Judged, calibration, figures, train_pillars, with_errors


@pytest.mark.slow
def test_the_command(tmp_path: Path) -> None:
    """Sweeps and frames of a recording are learned from, and what is learned is used."""
    train = ["train", "pillars", "--family", "sandbox", "--workers", "1", "--out", "mine.onnx", "--steps", "2"]
    done = called(tmp_path, *train, "--recordings", SANDBOX)
    assert done.code == 0, done.err
    assert {path.name for path in tmp_path.iterdir()} == {"mine.onnx", "mine.md", "mine.ckpt"}
    assert done.out.rstrip() == (tmp_path / "mine.md").read_text(encoding="utf-8").rstrip()
    assert "lidcam train pillars --family sandbox --recordings RECORDING \\\n      --steps 2 --seed 0 " in done.out
    assert "- from step 0 on as many sweeps of drawn worlds (`sandbox`)" in done.out
    assert "frames of recordings sandbox.bag" in " ".join(done.out.split())
    assert "- from step 0 on with the weights of `sandbox`" in done.out
    assert done.out.index("In drawn worlds:\n\n|") < done.out.index("In recordings:\n\n|")
    assert max(map(len, done.out.splitlines())) <= 80
    run = lidcam.process(SANDBOX, model_3d=tmp_path / "mine.onnx", duration_s=0.3, workers=1)
    assert (run.summary.sensors.box_source_3d, run.summary.frames.count > 1) == ("combined", True)


class KilledError(Exception):
    pass


def kill_at(step: int) -> Callable[[int, float], None]:
    def step_done(done: int, _: float) -> None:
        if done == step:
            raise KilledError

    return step_done


def scenes_of_a_round(row: int) -> list[Scene]:
    draw, scenes = np.random.default_rng(row), []
    for _ in range(SCENES_OF_A_ROUND):
        features = draw.standard_normal((30, len(FEATURES)), np.float32)
        heat = (draw.random((1, 16, 16)) > 0.95).astype(np.float32)
        cells = draw.permutation(256)[:5]
        numbers, weights = draw.standard_normal((5, BOX_NUMBERS), np.float32), draw.random(5, np.float32)
        scenes.append(Scene(features, draw.integers(0, 32 * 32, 30), Targets(heat, cells, numbers, weights)))
    return scenes


def made_rounds(_source: Source, _seed: int, first: int, last: int, _workers: int) -> Iterator[list[Scene]]:
    yield from map(scenes_of_a_round, range(first, last))


@pytest.mark.slow
def test_a_training_that_was_killed_goes_on_to_the_same_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed before the first checkpoint, within a round of worlds and at its end."""
    monkeypatch.setattr(fit, "rounds", made_rounds)
    at_once = fitted(Checkpoint(tmp_path / "a", Source("sandbox"), 3), 20, workers=1, step_done=kill_at(0))
    checkpoint = Checkpoint(tmp_path / "b", Source("sandbox"), 3)
    for step, every_s in ((2, 1e9), (5, 0), (8, 0)):
        with pytest.raises(KilledError):
            fitted(checkpoint, 20, workers=1, step_done=kill_at(step), every_s=every_s)
        assert checkpoint.path.exists() == (every_s == 0)
    parts = fitted(checkpoint, 20, workers=1, step_done=kill_at(0))
    assert all(torch.equal(one, parts.state_dict()[name]) for name, one in at_once.state_dict().items())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_training_goes_on_with_recordings_and_other_worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "rounds", made_rounds)
    recordings = Recordings((tmp_path,), (tmp_path,), (tmp_path,), tmp_path, ("a.mcap, SHA-256\n  abc",))
    worlds = Checkpoint(tmp_path / "a", Source("sandbox"), 3)
    sources = worlds, worlds._replace(source=Source("sandbox", recordings)), worlds, worlds._replace(bfloat16=True)
    for steps, source in enumerate(sources, 1):
        fitted(source, steps, workers=1, step_done=kill_at(0))
    history = worlds.load().history
    assert [step for step, _ in history] == [0, 1, 2, 3]
    assert history[3][1] == "drawn worlds (`sandbox`), in bfloat16"
    assert "drawn worlds (`sandbox`) and\n  frames of recordings\n  a.mcap" in history[1][1]

    save(Checkpoint(tmp_path / "b", Source("road"), 3), 2)
    assert Checkpoint(tmp_path / "b", Source("all"), 3).load().step == 2
    families = [family_of("all", number) for number in range(5)]
    assert families == ["road", "road", "crossing", "crossing", "road"]


def save(checkpoint: Checkpoint, step: int) -> None:
    network = torch_network.PillarNetwork(len(CLASSES[checkpoint.source.worlds]))
    checkpoint.save(network, torch.optim.AdamW(network.parameters()), step, 1.0)


@pytest.mark.parametrize(
    ("content", "family", "steps", "message"),
    [
        (b"", "sandbox", 9, "expected the state of a training of --family sandbox --seed 0, found"),
        (b"torch", "sandbox", 9, "expected the state of a training"),
        (None, "road", 9, "a training of --family road --seed 0, found --family sandbox --seed 0"),
        (None, "sandbox", 6, "is already at step 7; pass --steps 7 or more"),
        ({"step": -1}, "sandbox", 9, "expected the state of a training of .*, found 1 validation error"),
        ({"network": {}}, "sandbox", 9, "expected the state of a training of .*, found Error"),
        ({"optimiser": {}}, "sandbox", 9, "expected the state of a training of .*, found 'param_groups'"),
    ],
)
def test_a_checkpoint_that_cannot_be_used(
    tmp_path: Path, content: bytes | dict[str, object] | None, family: Worlds, steps: int, message: str
) -> None:
    path = tmp_path / "mine.ckpt"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        save(Checkpoint(path, Source("sandbox"), 0), 7)
    if isinstance(content, dict):
        torch.save(torch.load(path, weights_only=True) | content, path)
    with pytest.raises(LidcamError, match=message):
        fitted(Checkpoint(path, Source(family), 0), steps, workers=1, step_done=kill_at(0))


@pytest.mark.parametrize("cells", [GRIDS["road"].cells, 320])
def test_the_file_gives_what_the_network_gives(tmp_path: Path, cells: int) -> None:
    """onnxruntime against PyTorch, also for a larger grid than was learned in; the order of points does not matter."""
    torch.manual_seed(0)
    network, learned, draw = torch_network.PillarNetwork(5), GRIDS["road"], np.random.default_rng(0)
    grid = learned.model_copy(update={"cells": cells})
    for part in network.modules():
        if isinstance(part, (torch.nn.BatchNorm1d, torch.nn.BatchNorm2d)):  # as if it had learned
            part.running_mean.uniform_(-0.3, 0.3), part.running_var.uniform_(0.5, 2.0)
            torch.nn.init.uniform_(part.weight, 0.5, 1.5), torch.nn.init.uniform_(part.bias, -0.3, 0.3)
    specs = PillarSpecs(classes=tuple(FoundClass(name=name) for name in CLASSES["road"]), grid=grid)
    path = tmp_path / "net.onnx"
    path.write_bytes(onnx_bytes(network, specs, learned))
    again = torch_network.PillarNetwork(5)
    take_weights(again, path, CLASSES["road"], learned)
    for name, values in network.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], values, check_dtype=name != "num_batches_tracked")
    position = draw.uniform((-50, -50, 0), (50, 50, 5), (20_000, 3))
    features, pillar = pillars(position, grid)
    features[:, FEATURES.index("distance")] *= grid.half_m / learned.half_m
    with torch.no_grad():
        output = network(torch.from_numpy(features), torch.from_numpy(pillar), 1, grid.cells)[0].numpy()
    threshold = float(np.quantile(output[:-BOX_NUMBERS], 0.999))
    expected, found = boxes_of(output, grid, threshold), PillarNetwork(path)(position, threshold)
    assert len(expected.yaws) > 20
    rows, other_rows = (np.lexsort(one.centers.T) for one in (expected, found))  # equal peaks have no order
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_allclose(one[rows], other[other_rows], atol=1e-4)
    for one, other in zip(found, PillarNetwork(path)(draw.permutation(position), threshold), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_training_begins_with_an_embedded_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its state says so, and goes on at the low rate."""
    take_weights(torch_network.PillarNetwork(5), EMBEDDED["traffic"], CLASSES["all"], GRIDS["all"])
    monkeypatch.setattr(fit, "rounds", made_rounds)
    monkeypatch.setattr(fit, "MAX_RATE_ONWARD", 0.0)
    first = torch_network.PillarNetwork(1)
    take_weights(first, EMBEDDED["sandbox"], CLASSES["sandbox"], GRIDS["sandbox"])
    checkpoint = Checkpoint(tmp_path / "a", Source("sandbox"), 0, begin="sandbox")
    with pytest.raises(KilledError):
        fitted(checkpoint, 2, workers=1, step_done=kill_at(1), every_s=0)
    trained = fitted(checkpoint, 2, workers=1, step_done=kill_at(0))
    assert all(torch.equal(one, two) for one, two in zip(first.parameters(), trained.parameters(), strict=True))
    assert checkpoint.load().history[0] == (0, "with the weights of `sandbox`")


@pytest.mark.parametrize(("first", "then"), [("sandbox", ""), ("", "sandbox")])
def test_a_training_goes_on_from_what_it_began_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: str, then: str
) -> None:
    """Whatever is asked for then: the network that it began with is judged, and its weights are mixed in."""
    checkpoint, begun = Checkpoint(tmp_path / "a", Source("sandbox"), 0, begin=first), list[str]()

    def going_on(checkpoint: Checkpoint, *_: object, **__: object) -> None:
        begun.append(checkpoint.begin)
        raise KilledError

    save(checkpoint, 7)
    monkeypatch.setattr(train, "fitted", going_on)
    monkeypatch.setattr(train, "judged_world", lambda *_: None)
    monkeypatch.setattr(train, "joined", lambda _: None)
    with pytest.raises(KilledError):
        train_pillars(
            checkpoint._replace(begin=then),
            tmp_path / "b",
            9,
            workers=1,
            progress=lambda *_: None,
            begun=lambda before: begun.append(*before or ["nothing"]),
        )
    assert begun == (["drawn worlds", "sandbox"] if first else ["nothing", ""])


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_weights_are_mixed_by_share(share: float) -> None:
    network, other = torch_network.PillarNetwork(1), torch_network.PillarNetwork(1)
    before = {name: values.clone() for name, values in network.state_dict().items()}
    for one, weight in ((other, 1.0), (network, share)):
        take_weights(one, EMBEDDED["sandbox"], CLASSES["sandbox"], GRIDS["sandbox"], weight)
    for name, mixed in network.state_dict().items():
        if mixed.is_floating_point():
            torch.testing.assert_close(mixed, (1 - share) * before[name] + share * other.state_dict()[name])


@pytest.mark.parametrize(
    ("file", "worlds", "message"),
    [
        ("sandbox", "road", r"finds car, pedestrian, .* in pillars of 0.32 m, found car in 0.04 m"),
        ("none.onnx", "road", "none.onnx: expected an ONNX file, found no such file$"),
        ("constant.onnx", "sandbox", "found one with other layers: train it anew"),
    ],
)
def test_a_network_that_no_training_begins_with(tmp_path: Path, file: str, worlds: Worlds, message: str) -> None:
    numbers = np.zeros((1 + BOX_NUMBERS, 32, 32), np.float32)
    write_pillars(tmp_path / "constant.onnx", numbers, [{"name": "car"}], grid=GRIDS["sandbox"].model_dump())
    path = EMBEDDED.get(file, tmp_path / file)
    network = torch_network.PillarNetwork(len(CLASSES[worlds]))
    with pytest.raises(LidcamError, match=message):
        take_weights(network, path, CLASSES[worlds], GRIDS[worlds])


def test_targets_say_what_boxes_are_read() -> None:
    """Of four objects: one beyond the grid, one of too few points."""
    grid = GRIDS["road"]
    centers = np.array([[5.0, -7.0, 0.8], [-20.3, 11.0, 0.9], [99.0, 0.0, 0.8], [0.0, 0.0, 0.8]])
    sizes, yaws = np.array([[4.0, 1.7, 1.5], [0.6, 0.5, 1.8], [4.0, 1.7, 1.5], [4.0, 1.7, 1.5]]), np.arange(4.0)
    true = TrueBoxes(centers, sizes, yaws, np.array([0, 1, 0, 0]), np.array([50, 9, 50, 2]))
    targets = targets_of(true, grid, 5)
    assert (targets.heat == 1).sum((1, 2)).tolist() == [1, 1, 0, 0, 0]
    output = np.zeros((5 + BOX_NUMBERS, *targets.heat.shape[1:]), np.float32)
    output[:5] = targets.heat
    output[5:].reshape(BOX_NUMBERS, -1)[:, targets.cells] = targets.numbers.T
    found = boxes_of(output, grid, 0.95)
    np.testing.assert_allclose(found.centers, centers[:2], atol=1e-5)
    np.testing.assert_allclose(found.sizes, sizes[:2], rtol=1e-5)
    np.testing.assert_allclose(found.yaws, yaws[:2], atol=1e-6)


def test_scores_become_probabilities() -> None:
    """Log odds that are half as large as they should be, and one too high; a class of no box stays as it is."""
    draw, true_odds = random_numbers_of("road", 0), np.linspace(-5, 5, 4000)
    is_right = draw.random(4000) < 1 / (1 + np.exp(-true_odds))
    errors = np.where(is_right[:, None], 0.1, np.nan) * np.ones(3)
    found = Judged(true_odds / 2 + 1, np.zeros(4000, np.int64), is_right, errors, np.array([is_right.sum(), 0]))
    np.testing.assert_allclose(calibration(found), [[2, -2], [1, 0]], atol=0.25)
    car, none = figures(("car", "bus"), found).splitlines()[2:]
    assert car.startswith(f"| car | {is_right.sum()} | ")
    assert car.endswith("| 0.141 m | 5.7 deg | 0% |")
    assert none == "| bus | 0 | 0 | 0 | 0.000 | 0.000 | -- | -- | -- |"
    car_class, bus_class = with_errors(("car", "bus"), found, np.array([19, 20]))
    assert (car_class.sigma_m, car_class.recorded, bus_class.sigma_m, bus_class.recorded) == (0.1, False, 0.3, True)
