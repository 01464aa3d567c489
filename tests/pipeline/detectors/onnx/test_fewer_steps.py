"""Networks in fewer steps give what they gave; the judge is onnxruntime with the file as it is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import shared
from onnx_files import FLOAT, _bytes, _int, _ints, _node, _tensor, _value, _varint_field
from onnx_networks import INT64, _write

from pipeline.core.arrays import F32, Array
from pipeline.core.settings.config import Config
from pipeline.core.settings.detect import Detect2DConfig
from pipeline.detectors.onnx import session
from pipeline.detectors.onnx.detector import OnnxDetector2D
from pipeline.detectors.onnx.fewer_steps import drop_last_transposes, fold_focus
from pipeline.detectors.onnx.model_file import read_model, written_model
from pipeline.detectors.onnx.session import OnnxSession

CHANCE = np.random.default_rng(7)
KERNEL = CHANCE.normal(0, 1, (5, 12, 3, 3))
YOLOX = ((0, 0), (1, 0), (0, 1), (1, 1))
END = (1 << 63) - 1
PADS = _ints("pads", [1, 1, 1, 1])


def constant(name: str, numbers: Sequence[int], kind: int = INT64) -> bytes:
    real = np.int64 if kind == INT64 else np.int32
    return _tensor(name, np.array(numbers, real), kind)


def focus(
    path: Path,
    *,
    kernel: Array = KERNEL,
    corners: Sequence[tuple[int, int]] = YOLOX,
    axes: Sequence[Sequence[int]] = ((2,), (3,)),
    step: int = 2,
    end: int = END,
    kind: int = INT64,
    by_nodes: bool = False,
    images: Sequence[str] = ("images",) * 4,
    axis: int = 1,
    attributes: Sequence[bytes] = (PADS,),
    free_kernel: bool = False,
    nodes: Sequence[bytes] = (),
    outputs: Sequence[str] = ("output",),
) -> Path:
    """Write a network that begins with Focus, or with something like it; `axes` are those of each slice in turn."""
    written = [_node("Relu", ["images"], "bright")]
    constants: dict[str, list[int]] = {}
    for row, (corner, image) in enumerate(zip(corners, images, strict=True)):
        for turn, of in enumerate(axes):
            size, starts, along = len(of), f"starts{row}{turn}", f"axes{turn}"
            constants |= {starts: [corner[one - 2] for one in of], along: list(of)}
            constants |= {f"step{size}": [step] * size, f"end{size}": [end] * size}
            inputs = [f"slice{row}{turn - 1}" if turn else image, starts, f"end{size}", along, f"step{size}"]
            written.append(_node("Slice", inputs, f"slice{row}{turn}"))
    if by_nodes:
        made = [
            _node("Constant", [], name, _bytes(1, b"value") + _bytes(5, constant("", told)) + _varint_field(20, 4))
            for name, told in constants.items()
        ]
        written[:0] = made
    last = [f"slice{row}{len(axes) - 1}" for row in range(len(corners))]
    written += [
        _node("Concat", last, "joined", _int("axis", axis)),
        _node("Conv", ["joined", "kernel", "bias"], "convolved", *attributes),
        _node("Sigmoid", ["convolved"], "output"),
        *nodes,
    ]
    stored = [] if by_nodes else [constant(name, told, kind) for name, told in constants.items()]
    stored.append(_tensor("kernel", kernel.astype(np.float32), FLOAT))
    stored.append(_tensor("bias", np.arange(len(kernel), dtype=np.float32), FLOAT))
    given = [_value("images", ("N", 3, "H", "W"), FLOAT)]
    given += [_value("kernel", kernel.shape, FLOAT)] if free_kernel else []
    return _write(path, written, stored, given, [_value(one, ("a", "b", "c", "d"), FLOAT) for one in outputs], None)


def ops(graph: Any) -> list[str]:
    return [node.op.decode() for node in graph.nodes]


def images(height_px: int = 32, width_px: int = 64) -> F32:
    return CHANCE.normal(0, 1, (2, 3, height_px, width_px)).astype(np.float32)


def check_equal(path: Path, *, tolerance: float = 1e-5) -> None:
    """The network in fewer steps gives the same, at several sizes."""
    judge = OnnxSession(path, threads=1, provider="cpu")
    quick = judge.in_fewer_steps()
    assert quick is not judge
    for fed in (images(), images(64, 32), images(6, 10)):
        expected, found = judge.run({"images": fed}, 2), quick.run({"images": fed}, 2)
        for one, other in zip(found, expected, strict=True):
            assert one.shape == other.shape
            np.testing.assert_allclose(one, other, atol=tolerance)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"corners": ((1, 1), (0, 1), (1, 0), (0, 0))},
        {"axes": ((3,), (2,))},
        {"axes": ((2, 3),)},
        {"axes": ((3, 2),), "by_nodes": True},
        {"by_nodes": True, "end": (1 << 31) - 1},
        {"images": ("bright",) * 4},
        {"kernel": CHANCE.normal(0, 1, (16, 12, 1, 1)), "attributes": ()},
        {"kernel": CHANCE.normal(0, 1, (3, 12, 2, 3)), "attributes": (_ints("pads", [1, 0, 2, 3]),)},
        {
            "attributes": (
                PADS,
                _ints("kernel_shape", [3, 3]),
                _ints("strides", [1, 1]),
                _ints("dilations", [1, 1]),
                _int("group", 1),
            )
        },
    ],
)
def test_focus_is_folded_into_the_convolution(tmp_path: Path, settings: dict[str, Any]) -> None:
    path = focus(tmp_path / "m.onnx", **settings)
    check_equal(path)
    graph = read_model(path.read_bytes()).graph
    assert fold_focus(graph)
    assert not {"Slice", "Concat", "Constant"} & set(ops(graph))
    assert not fold_focus(graph), "once is enough"


def test_slices_that_are_taken_by_others_stay(tmp_path: Path) -> None:
    nodes = [_node("Relu", ["slice20"], "half")]
    path = focus(tmp_path / "m.onnx", nodes=nodes, outputs=("output", "slice11", "half"))
    check_equal(path)
    graph = read_model(path.read_bytes()).graph
    assert fold_focus(graph)
    assert ops(graph).count("Slice") == 3, "two for the second output, one for the third"


def branch() -> bytes:
    """A node with a graph of its own, which may take any value."""
    taken = _bytes(1, _node("Identity", ["joined"], "inner")) + _bytes(2, b"g") + _bytes(12, _value("inner", (), FLOAT))
    parts = [_bytes(1, name) + _bytes(6, taken) + _varint_field(20, 5) for name in (b"then_branch", b"else_branch")]
    return _node("If", ["condition"], "chosen", *parts)


@pytest.mark.parametrize(
    "settings",
    [
        {"step": 3},
        {"end": 32},
        {"kind": 6, "end": (1 << 31) - 1},
        {"corners": ((0, 0), (1, 0), (0, 2), (1, 1))},
        {"corners": ((0, 0), (1, 0), (1, 0), (1, 1))},
        {"corners": YOLOX[:3], "images": ("images",) * 3, "kernel": KERNEL[:, :9]},
        {"axes": ((2,), (2,))},
        {"axes": ((2,),)},
        {"axes": ((1,), (3,))},
        {"axes": ((2,), (2, 3))},
        {"images": ("images", "images", "bright", "images")},
        {"axis": 0},
        {"kernel": KERNEL[:, :3]},
        {"attributes": (PADS, _int("group", 4)), "kernel": KERNEL[:4, :3]},
        {"attributes": (PADS, _ints("dilations", [2, 2]))},
        {"attributes": (PADS, _ints("strides", [2, 2]))},
        {"attributes": (PADS, _ints("strides", [1, 2]))},
        {"attributes": (_bytes(1, b"auto_pad") + _bytes(4, b"SAME_UPPER") + _varint_field(20, 3),)},
        {"free_kernel": True},
        {"outputs": ("output", "joined")},
        {"nodes": [_node("Relu", ["joined"], "more")]},
        {"nodes": [branch()]},
    ],
)
def test_what_nearly_looks_like_focus_stays(tmp_path: Path, settings: dict[str, Any]) -> None:
    model = read_model(focus(tmp_path / "m.onnx", **settings).read_bytes())
    before = written_model(model)
    assert not fold_focus(model.graph)
    assert written_model(model) == before


def test_a_kernel_that_is_not_in_the_file_stays(tmp_path: Path) -> None:
    model = read_model(focus(tmp_path / "m.onnx").read_bytes())
    kernel = next(one for one in model.graph.constants if one.name == b"kernel")
    for raw, kind in (
        (b"", FLOAT),
        (kernel.raw[:-1], FLOAT),
        (kernel.raw, 11),
        (kernel.raw[: len(kernel.raw) // 2], 10),
    ):
        kernel.raw, kernel.kind = raw, kind
        assert not fold_focus(model.graph)


def transposed(path: Path, nodes: Sequence[bytes], *outputs: str) -> Path:
    given = [_value("images", ("N", 3, "H", "W"), FLOAT)]
    stated = [_value(one, ("a", "b", "c", "d"), FLOAT) for one in outputs]
    return _write(path, nodes, [], given, stated, None)


def test_last_transposes_are_left_to_the_reader(tmp_path: Path) -> None:
    nodes = [
        _node("Relu", ["images"], "bright"),
        _node("Sigmoid", ["images"], "soft"),
        _node("Transpose", ["soft"], "output", _ints("perm", [0, 2, 3, 1])),
    ]
    path = transposed(tmp_path / "m.onnx", nodes, "bright", "output")
    check_equal(path, tolerance=0)
    graph = read_model(path.read_bytes()).graph
    assert drop_last_transposes(graph) == {1: [0, 2, 3, 1]}
    assert ops(graph) == ["Relu", "Sigmoid"]


@pytest.mark.parametrize(
    ("nodes", "outputs"),
    [
        ([_node("Transpose", ["soft"], "output")], ["output"]),
        ([_node("Transpose", ["images"], "output", _ints("perm", [0, 2, 3, 1]))], ["output"]),
        ([_node("Transpose", ["soft"], "output", _ints("perm", [0, 2, 3, 1]))], ["output", "soft"]),
        (
            [
                _node("Transpose", ["soft"], "output", _ints("perm", [0, 2, 3, 1])),
                _node("Relu", ["output"], "more"),
            ],
            ["output", "more"],
        ),
        (
            [_node("Transpose", ["soft"], "output", _ints("perm", [0, 2, 3, 1])), branch()],
            ["output"],
        ),
    ],
)
def test_other_transposes_stay(tmp_path: Path, nodes: Sequence[bytes], outputs: Sequence[str]) -> None:
    path = transposed(tmp_path / "m.onnx", [_node("Sigmoid", ["images"], "soft"), *nodes], *outputs)
    model = read_model(path.read_bytes())
    before = written_model(model)
    assert drop_last_transposes(model.graph) == {}
    assert written_model(model) == before


def test_a_network_without_such_steps_is_not_loaded_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = OnnxSession(focus(tmp_path / "a.onnx", step=3), threads=1, provider="cpu")
    assert plain.in_fewer_steps() is plain
    monkeypatch.setattr(session, "MAX_CHANGED_BYTES", 1000)
    large = OnnxSession(focus(tmp_path / "b.onnx"), threads=1, provider="cpu")
    assert large.in_fewer_steps() is large


def test_a_real_network_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    path = shared("weights/yolox_nano.onnx")
    pictures = sorted(shared("data/kitti_object/training/image_2").glob("*.png"))[:2]
    rgb = [cv2.cvtColor(np.asarray(cv2.imread(str(one))), cv2.COLOR_BGR2RGB).astype(np.uint8) for one in pictures]
    quick = OnnxDetector2D(path, Config())(rgb)
    monkeypatch.setattr(session, "fold_focus", lambda _: False)
    monkeypatch.setattr(session, "drop_last_transposes", lambda _: {})
    for one, expected in zip(quick, OnnxDetector2D(path, Config())(rgb), strict=True):
        assert len(expected.scores) > 10
        np.testing.assert_array_equal(one.labels, expected.labels)
        np.testing.assert_allclose(one.scores, expected.scores, atol=1e-3)
        np.testing.assert_allclose(one.xyxy, expected.xyxy, atol=1e-3, rtol=1e-5)


@pytest.mark.parametrize("size", ["auto", (416, 416), (640, 224)])
def test_a_real_network_is_run_in_fewer_steps_at_any_size(monkeypatch: pytest.MonkeyPatch, size: Any) -> None:
    """Also where its own size is what is wanted."""
    folded: list[bool] = []

    def watched(graph: Any) -> bool:
        folded.append(fold_focus(graph))
        return folded[-1]

    monkeypatch.setattr(session, "fold_focus", watched)
    OnnxDetector2D(shared("weights/yolox_nano.onnx"), Config(detect2d=Detect2DConfig(input=size)))
    assert folded == [True]
