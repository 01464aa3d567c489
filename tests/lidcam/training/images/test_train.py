"""`lidcam train images`: a step of it, which teaches nothing and shows that all of it works."""

# ruff: noqa: E402  # without torch the file is skipped before it imports what needs it

from collections.abc import Iterator
from itertools import repeat
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from command import called

torch = pytest.importorskip("torch", reason="needs the extra train")

from lidcam.pipeline.detectors.onnx.layouts.cells import YoloxReader, cell_count, cells_of
from lidcam.training.images import pictures, train
from lidcam.training.images.network import ImageNetwork
from lidcam.training.images.onnx_file import onnx_bytes
from lidcam.training.images.pictures import CLASSES, Cut, Picture, learnable

SIZE_PX = (160, 192)


@pytest.fixture
def one_image(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(pictures, "IMAGES_OF_A_WORLD", 1)
    monkeypatch.setattr(pictures, "WORLDS_OF_A_ROUND", 1)
    monkeypatch.setattr(train, "HELD_OUT", 3)  # a sandbox, which is drawn in no time
    pictures.pictures.cache_clear()
    yield
    pictures.pictures.cache_clear()


def cut(*boxes: tuple[float, ...], classes: tuple[int, ...] = (), sure: tuple[bool, ...] = ()) -> Cut:
    rgb = np.random.default_rng(1).integers(0, 255, (*SIZE_PX, 3), np.uint8)
    xyxy, kinds = np.array(boxes, np.float64).reshape(-1, 4), np.array(classes, np.int64)
    return learnable(Picture(rgb, xyxy, kinds, np.array(sure, np.bool_)))


@pytest.mark.usefixtures("one_image")
def test_the_command(tmp_path: Path) -> None:
    """From a rendered image to a network that finds something in images, good or bad, and its card."""
    done = called(tmp_path, "train", "images", "--steps", "1", "--seed", "3", "--out", "mine.onnx")
    assert done.code == 0, done.err
    assert {path.name for path in tmp_path.iterdir()} == {"mine.onnx", "mine.md"}
    assert done.out.rstrip() == (tmp_path / "mine.md").read_text(encoding="utf-8").rstrip()
    assert "lidcam train images --steps 1 --seed 3 --out FILE.onnx" in done.out
    assert max(map(len, done.out.splitlines())) <= 80


BOXES = [(3.0, 20.0, 21.0, 60.0), (60.0, 30.0, 150.0, 90.0), (5.0, 3.0, 185.0, 157.0)]


@pytest.mark.parametrize("boxes", [BOXES[:0], BOXES[:1], BOXES])
def test_what_the_network_should_say_is_read_as_the_true_boxes(boxes: list[tuple[float, ...]]) -> None:
    """Of a network that says it in all cells that learn a box; and the loss of that is least."""
    classes = tuple(range(len(boxes)))
    learned = cut(*boxes, classes=classes, sure=(True,) * len(boxes))
    said = np.zeros((1, cell_count(SIZE_PX), 5 + len(CLASSES)), np.float32)
    said[..., 4] = -20
    said[0, learned.heat == 1, 4] = 20
    grid, stride_px = (cells[learned.cells] for cells in cells_of(SIZE_PX))
    low, high = learned.xyxy[:, :2], learned.xyxy[:, 2:]
    said[0, learned.cells, :2] = (low + high) / 2 / stride_px - grid
    said[0, learned.cells, 2:4] = np.log((high - low) / stride_px)
    said[0, learned.cells, 5 + learned.classes] = 20

    exported = said.copy()
    exported[..., 4:] = 1 / (1 + np.exp(-said[..., 4:]))
    found = YoloxReader(len(CLASSES), is_in_pixels=False)([exported], 1, SIZE_PX, 0.5)[0]
    order = np.argsort(found.labels)
    np.testing.assert_array_equal(found.labels[order], classes)
    np.testing.assert_allclose(found.xyxy[order], np.array(boxes).reshape(-1, 4), atol=1e-3)

    def loss(numbers: np.ndarray) -> float:
        return train.loss_of(lambda _: torch.from_numpy(numbers), [learned]).item()

    assert loss(said) == pytest.approx(0, abs=1e-3)
    for column in range(5 + len(boxes)) if boxes else []:
        wrong = said.copy()
        wrong[0, learned.cells, column] -= 0.5 if column < 4 else 30
        assert loss(wrong) > 0.02


def test_what_is_hidden_is_neither_learned_nor_denied() -> None:
    hidden = cut(BOXES[1], classes=(0,), sure=(False,))
    assert len(hidden.cells) == 0
    assert hidden.heat.max() == pytest.approx(0.9)


def test_a_file_says_what_the_network_says() -> None:
    torch.manual_seed(0)
    network = ImageNetwork(len(CLASSES))
    images = 255 * torch.rand(2, 3, *SIZE_PX)
    with torch.no_grad():
        network(images)  # normalises by what it sees
        said = network.eval()(images).numpy()
    said[..., 4:5] = 1 / (1 + np.exp(-said[..., 4:5]))
    said[..., 5:] = np.exp(said[..., 5:]) / np.exp(said[..., 5:]).sum(2, keepdims=True)
    session = onnxruntime.InferenceSession(onnx_bytes(network, CLASSES))
    np.testing.assert_allclose(session.run(None, {"images": images.numpy()})[0], said, atol=1e-3)


def test_the_same_seed_makes_the_same_network(monkeypatch: pytest.MonkeyPatch) -> None:
    learned = cut(*BOXES, classes=(0, 1, 2), sure=(True,) * 3)
    monkeypatch.setattr(train, "cuts", lambda _: repeat(learned))
    losses: list[float] = []
    first, second = (train.fitted(5, 3, lambda _, loss: losses.append(loss)).state_dict() for _ in range(2))
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert losses[:3] == losses[3:]
    assert losses[2] < losses[0]
