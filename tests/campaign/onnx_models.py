"""Hostile and damaged ONNX files: `python tests/campaign/onnx_models.py [--minutes M | --count N] [--seed S]`.

Each is loaded and run in a process of its own. It may work; else one `ModelError` in one line must say why, in bounded
time and memory, and nothing outside of the model's folder may be read.
"""

import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

from common import Outcome, campaign, is_one_line, run_child  # isort: skip
import numpy as np
from onnx import NodeProto, TensorProto, ValueInfoProto, helper
from onnx_files import FLOAT, INT64, _node, _tensor, _value, write_model, write_yolox
from onnx_networks import write_network

from lidcam.pipeline.core.arrays import Array

MAX_SECONDS = 90.0
MAX_MIB = 5000
SIZE_PX = (64, 64)
ROWS = 64 + 16 + 4
OUTPUT = (1, ROWS, 85)
BOOL = 9
NAMES = {row: f"class {row}" for row in range(80)}
LAYOUTS: tuple[dict[str, tuple[int, ...]], ...] = (
    {"output0": (3 * ROWS, 85)},
    {"output0": (84, ROWS)},
    {"output0": (300, 6)},
    {"output0": (300, 84)},
    {"logits": (300, 80), "pred_boxes": (300, 4)},
    {"labels": (300,), "boxes": (300, 4), "scores": (300,)},
)
"""Shapes of the outputs of networks other than YOLOX."""

SECRET = 0.3125
"""What a weight file outside of the model's folder holds."""

LOAD = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (16 << 30, 16 << 30))
from pathlib import Path
import numpy as np
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D
try:
    found = OnnxDetector2D(Path(sys.argv[1]), Detect2DConfig())([np.zeros((48, 64, 3), np.uint8)] * 3)
except LidcamError as err:
    print("told:", err)
else:
    print("works:", float(np.nan_to_num(found[0].scores).max(initial=0)))
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """1 if a model crashed the program, hung it, filled the memory, or read what is not its own."""
    return campaign("onnx_models", _try_case, count=200, arguments=arguments, max_case_s=MAX_SECONDS + 30)


def _try_case(number: int, chance: Random) -> Outcome:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "model"
        folder.mkdir()
        np.full(OUTPUT, SECRET, np.float32).tofile(folder.parent / "outside.bin")
        np.full(OUTPUT, 0.25, np.float32).tofile(folder / "inside.bin")
        (folder / "link.bin").symlink_to("../outside.bin")
        path = folder / "a.onnx"
        make = HOSTILE[number % len(HOSTILE)] if number % 2 else chance.choice((_bytes_changed, _cut))
        told, may_work = make(path, chance)
        child = run_child(
            [sys.executable, "-c", LOAD, path], timeout_s=MAX_SECONDS, env={"HOME": scratch, "OMP_NUM_THREADS": "1"}
        )
        detail = f"{told}: exit {child.returncode}, {child.seconds:.1f} s, {child.peak_mib} MiB: "
        detail += (child.stdout + child.stderr)[-2000:]
        files = {"a.onnx": path.read_bytes()}
    said = child.stdout.strip()
    works = said.startswith("works")
    faults = {
        "hang": child.is_hung,
        "crash": child.has_traceback or child.returncode != 0,
        "memory": child.peak_mib > MAX_MIB,
        "more than one line": not is_one_line(said) or child.stderr.strip() != "",
        "works, and must not": works and not may_work,
    }
    for kind, is_fault in faults.items():
        if is_fault:
            return Outcome(kind, is_fault=True, detail=detail, files=files)
    return Outcome("works" if works else "told", detail=detail)


def _sound(path: Path, chance: Random) -> Path:
    rng, batch = np.random.default_rng(chance.randrange(1000)), chance.choice((1, 2, "N"))
    if chance.random() < 0.3:
        return write_yolox(path, rng.uniform(0, 1, (ROWS, 85)).astype(np.float32), size_px=SIZE_PX, batch=batch)
    shapes = chance.choice(LAYOUTS)
    outputs: dict[str, Array] = {name: rng.uniform(0, 1, shape).astype(np.float32) for name, shape in shapes.items()}
    if "labels" in shapes and "scores" in shapes:
        outputs |= {"labels": rng.integers(0, 80, shapes["labels"])}
    scaled = ("boxes",) if "labels" in shapes else ()
    size_px = chance.choice((SIZE_PX, ("height", "width")))
    return write_network(path, outputs, size_px=size_px, batch=batch, scaled=scaled, metadata={"names": str(NAMES)})


def _bytes_changed(path: Path, chance: Random) -> tuple[str, bool]:
    data = bytearray(_sound(path, chance).read_bytes())
    head = len(data) if chance.random() < 0.3 else 700
    for _ in range(chance.randint(1, 8)):
        data[chance.randrange(min(head, len(data)))] = chance.randrange(256)
    path.write_bytes(data)
    return "bytes changed", True


def _cut(path: Path, chance: Random) -> tuple[str, bool]:
    data = _sound(path, chance).read_bytes()
    path.write_bytes(data[: chance.choice((0, 1, chance.randrange(len(data)), len(data) - 1))])
    return "cut", False


def _sizes(path: Path, chance: Random) -> tuple[str, bool]:
    side = chance.choice((0, -32, 32, 4096, 1 << 15, 1 << 20, (1 << 31) - 32, 1 << 40))
    other = chance.choice((side, 64))
    batch = chance.choice((1, 1, 0, -1, 4096, 1 << 31, "N"))
    _network(path, [], _value("images", (batch, 3, side, other), FLOAT))
    return f"an input of {batch} x {side} x {other}", side == other == 32  # where 84 x 85 is an output of YOLOv8


def _network(
    path: Path,
    nodes: Sequence[NodeProto],
    inputs: ValueInfoProto | None = None,
    *,
    bias: TensorProto | None = None,
    added: str = "bias",
    constants: Sequence[TensorProto] = (),
    domain: str = "",
) -> None:
    """A network that adds nothing to its bias, or to what other nodes make."""
    main = [
        _node("ReduceMean", ["images"], "mean", axes=[1, 2, 3], keepdims=0),
        _node("Unsqueeze", ["mean"], "column", axes=[1, 2]),
        _node("Mul", ["column", "zero"], "nothing"),
        _node("Add", ["nothing", added], "output0"),
    ]
    bias = bias or _tensor("bias", np.full(OUTPUT, 0.25, np.float32), FLOAT)
    zero = _tensor("zero", np.zeros((1, 1, 1), np.float32), FLOAT)
    shown = [inputs or _value("images", (1, 3, *SIZE_PX), FLOAT)]
    stated = [_value("output0", OUTPUT, FLOAT)]
    write_model(path, [*nodes, *main], (zero, bias, *constants), shown, stated, domain=domain)


def _constant(name: str, values: Array) -> NodeProto:
    """A node that gives whole numbers."""
    return _node("Constant", [], name, value=_tensor("", values, INT64))


def _outside(path: Path, chance: Random) -> tuple[str, bool]:
    outside = path.parent.parent / "outside.bin"
    location = chance.choice(
        ("../outside.bin", str(outside), "link.bin", "./x/../../outside.bin", "inside.bin", "no.bin", "/dev/zero", "")
    )
    length = chance.choice((ROWS * 85 * 4, 0, 1, 2**40))
    offset = chance.choice((0, 0, 0, 2**62, -1))
    entries = {"location": location, "offset": str(offset), "length": str(length)}
    bias = TensorProto(name="bias", data_type=FLOAT, dims=OUTPUT, data_location=TensorProto.EXTERNAL)
    for key, value in entries.items():
        bias.external_data.add(key=key, value=value)
    _network(path, [], bias=bias)
    return f"weights of {length} bytes in {location}", location == "inside.bin"


def _huge_constant(path: Path, chance: Random) -> tuple[str, bool]:
    """A constant of many gigabytes from a file of few bytes, used or folded away."""
    shape = np.array(chance.choice(([1 << 16, 1 << 16], [1 << 20, 1 << 20], [1 << 31, 8], [1 << 14, 1 << 14, 20])))
    nodes = [_constant("shape", shape), _node("ConstantOfShape", ["shape"], "huge")]
    used = chance.choice(("ReduceSum", "Exp", "Identity"))
    nodes.append(_node(used, ["huge"], "small", **({"keepdims": 1} if used == "ReduceSum" else {})))
    added = "bias"
    if chance.random() < 0.7:  # else nothing needs it
        nodes += [_node("ReduceMean", ["small"], "point", keepdims=0), _node("Add", ["point", "bias"], "sum")]
        added = "sum"
    _network(path, nodes, added=added)
    return f"a constant of {shape.tolist()}, {used}", True


def _tiles(path: Path, chance: Random) -> tuple[str, bool]:
    """A tensor that grows a thousandfold, again and again, while the network runs."""
    times = chance.randint(1, 4)
    repeats = np.array([1, 1, 1000, 1000] if chance.random() < 0.5 else [1000, 100, 1, 1], np.int64)
    nodes = [_constant("repeats", repeats)]
    nodes += [_node("Tile", [f"t{i}" if i else "images", "repeats"], f"t{i + 1}") for i in range(times)]
    nodes += [_node("ReduceMean", [f"t{times}"], "point", keepdims=0), _node("Add", ["point", "bias"], "sum")]
    _network(path, nodes, added=chance.choice(("bias", "sum")))
    return f"{times} tiles", True


def _loop(path: Path, chance: Random) -> tuple[str, bool]:
    """A loop of 2^62 turns whose result the output needs."""
    del chance
    inner = _node("Identity", ["cond_in"], "cond_out"), _node("Add", ["sum_in", "sum_in"], "sum_out")
    before = [_value("turn", (), INT64), _value("cond_in", (), BOOL), _value("sum_in", OUTPUT, FLOAT)]
    after = [_value("cond_out", (), BOOL), _value("sum_out", OUTPUT, FLOAT)]
    body = helper.make_graph(inner, "body", before, after)
    turns, true = _tensor("turns", np.array(1 << 62), INT64), _tensor("true", np.array(True), BOOL)
    start = _tensor("start", np.zeros(OUTPUT, np.float32), FLOAT)
    loop = _node("Loop", ["turns", "true", "start"], "endless", body=body)
    _network(path, [loop], added="endless", constants=(turns, true, start))
    return "a loop without end", False


def _custom(path: Path, chance: Random) -> tuple[str, bool]:
    domain = chance.choice(("", "com.example", "com.microsoft", "ai.onnx.ml", "../../lib"))
    op = chance.choice(("System", "../evil.so", "LoadLibrary", "PyOp", "Add" * 1000))
    _network(path, [_node(op, ["images"], "custom", domain=domain)], domain=domain)
    return f"the operator {op[:20]} of {domain!r}", False


def _not_finite(path: Path, chance: Random) -> tuple[str, bool]:
    value = chance.choice((np.nan, np.inf, -np.inf, 1e38, 1000.0))
    _network(path, [], bias=_tensor("bias", np.full(OUTPUT, value, np.float32), FLOAT))
    return f"outputs of {value}", value in {1e38, 1000.0}


def _names(path: Path, chance: Random) -> tuple[str, bool]:
    """Names of classes that nobody has, and too many of them."""
    deep = "{" * 50_000, "[" * 50_000, "{0: " * 5000, "-" * (1 << 21)
    text = chance.choice((*deep, "&a [*a, *a]", "{0: 1}", "", "\0", "!!python/name:os"))
    key = chance.choice(("names", "names", "names", "stride", "imgsz", "task"))
    output = np.full((ROWS, 85), 0.25, np.float32)
    write_network(path, {"output0": output}, size_px=SIZE_PX, metadata={"names": str(NAMES)} | {key: text})
    return f"{key} {text[:20]!r}", key in {"stride", "imgsz"}


Make = Callable[[Path, Random], tuple[str, bool]]
OFTEN: tuple[Make, ...] = (_sizes, _outside, _huge_constant)
ONCE: tuple[Make, ...] = (_loop, _tiles, _custom, _not_finite, _names)
HOSTILE = 2 * OFTEN + ONCE

if __name__ == "__main__":
    sys.exit(main())
