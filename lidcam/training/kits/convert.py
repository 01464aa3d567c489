"""Conversion of a kit's checkpoint to a file that `--model-3d` takes.

None of the kits' files is executed.
"""

import ast
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import yaml
from pydantic import ValidationError

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES, parse_yaml
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.detectors.pillars.kits import KEY, KIT_INPUTS, KIT_OUTPUTS, KitSpecs
from lidcam.training.kits.graph import add_network
from lidcam.training.kits.mmdet3d import mmdet3d_model
from lidcam.training.kits.model import Data
from lidcam.training.kits.openpcdet import openpcdet_model
from lidcam.training.onnx_graph import FLOAT, INT64, Graph
from lidcam.training.torch_file import torch_file

MAX_NUMBERS = 1 << 27  # Of all layers: 1 GiB in memory. Small files may claim more, by repeating some

BASE = "_BASE_CONFIG_"


class Checkpoint(NamedTuple):
    """Weights by name of the layer, and the configuration that mmdetection3d puts beside them; empty: none."""

    weights: dict[str, F64]
    config: str


class _StandIn:
    """Takes the place of objects of other classes; none of their code is called."""

    def __init__(self, *_: object) -> None:
        pass

    def __setstate__(self, _: object) -> None:
        pass


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint of either kit as tensors and plain values: objects of other classes are left out.

    Raises ModelError if it cannot be read this way, or the boxes of the version that trained it mean something else.
    """
    expected = f"{path}: expected a checkpoint of OpenPCDet or mmdetection3d"
    try:
        content: Any = _loaded(path)
        named = next((content[key] for key in ("model_state", "state_dict") if key in content), content)
        weights = _weights(named)
        meta = content.get("meta", {})
        texts = [meta.get(key) for key in ("cfg", "config", "mmdet3d_version")]
        config = next((one for one in texts[:2] if isinstance(one, str)), "")
        version = texts[2] if isinstance(texts[2], str) else "1"
    except Exception as err:  # errors of pickled files share no base class
        cause = err.__context__ or err  # PyTorch's own error advises to read the file unsafely
        reason = one_line(f"{type(cause).__name__}: {cause}", max_characters=300)
        found = "an ONNX network" if path.suffix == ".onnx" else reason
        found = "no such file" if isinstance(err, FileNotFoundError) else found
        raise ModelError(f"{expected}, found {found}") from err
    if version.startswith("0."):
        raise ModelError(
            f"{path}: expected mmdetection3d 1.0 or later, found {version}, whose boxes are turned otherwise"
        )
    return Checkpoint(weights, config)


def _weights(named: Any) -> dict[str, F64]:
    if (count := sum(one.numel() for one in named.values())) > MAX_NUMBERS:
        raise ValueError(f"layers of {count} numbers")
    return {name.removeprefix("module."): np.asarray(one.detach().double().numpy()) for name, one in named.items()}


def _loaded(path: Path) -> Any:
    """Load it with stand-ins for all classes that PyTorch does not know to be safe, such as the log of mmengine."""
    with torch_file(path) as file:
        try:
            strange = torch.serialization.get_unsafe_globals_in_checkpoint(file)
        except Exception:  # the older format, which OpenPCDet uses, does not say
            strange = []
        file.seek(0)
        with torch.serialization.safe_globals([(_StandIn, name) for name in strange]):
            return torch.load(file, map_location="cpu", weights_only=True)


def read_config(path: Path, text: str = "") -> dict[str, Any]:
    """Read a configuration: YAML of OpenPCDet with the files that it is based on; JSON or Python of mmengine.

    Args:
        path: The file, or the source of the text.
        text: Python; empty: read the file.

    Raises:
        ModelError: it cannot be read, or is based on files that would have to be executed.
    """
    expected = f"{path}: expected a configuration of OpenPCDet or mmdetection3d"
    try:
        is_python = bool(text) or path.suffix == ".py"
        text = text or read_small_text(path, MAX_YAML_BYTES, "a configuration", ModelError)
        found = _python(text) if is_python else _with_bases(parse_yaml(text), path)
    except (yaml.YAMLError, SyntaxError, ValueError, RecursionError, MemoryError) as err:
        raise ModelError(f"{expected}, found {one_line(err, max_characters=300)}") from err
    if not isinstance(found, dict) or "_base_" in found:
        raise ModelError(f"{expected} with all of it in one file, as tools/misc/print_config.py prints it")
    return found


def _python(text: str) -> dict[str, Any]:
    """The values that it assigns, except those that would have to be computed."""
    found: dict[str, Any] = {}
    for line in ast.parse(text.removeprefix("Config:\n")).body:
        if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name):
            try:
                found[line.targets[0].id] = _value(line.value)
            except ValueError:
                continue
    return found


def _value(node: ast.expr) -> Any:
    """The value of a literal; `dict(a=1)` counts as one, and tuples become lists."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict" and not node.args:
        return {str(one.arg): _value(one.value) for one in node.keywords}
    if isinstance(node, ast.Dict):
        return {ast.literal_eval(key or node): _value(one) for key, one in zip(node.keys, node.values, strict=True)}
    if isinstance(node, ast.List | ast.Tuple):
        return [_value(one) for one in node.elts]
    return ast.literal_eval(node)


def _with_bases(config: Any, path: Path) -> Any:
    """The configuration merged with its base files, whose paths start from the folder `tools` of OpenPCDet."""
    if not isinstance(config, dict):
        return config
    config = {key: _with_bases(value, path) for key, value in config.items()}
    if (base := config.pop(BASE, None)) is None:
        return config
    found = next((one for folder in path.absolute().parents if (one := folder / str(base)).is_file()), None)
    if found is None:
        raise ValueError(f"no file {base}, on which it is based, in a folder above")
    return _merged(read_config(found), config)


def _merged(base: dict[str, Any], changed: dict[str, Any]) -> dict[str, Any]:
    shared = [key for key in base.keys() & changed.keys() if isinstance(base[key], dict)]
    return base | changed | {key: _merged(base[key], changed[key]) for key in shared if isinstance(changed[key], dict)}


def converted(network: Path, config: Path | None, given: Data) -> tuple[bytes, KitSpecs]:
    """Convert a network into the content of a file for `--model-3d`, and the metadata in it.

    Args:
        network: Checkpoint.
        config: Configuration; None: the one that mmdetection3d put into the checkpoint.
        given: Values that take precedence over those known for the data set.

    Raises:
        ModelError: a file cannot be read, or lidcam cannot run the network.
    """
    checkpoint = read_checkpoint(network)
    if config is None and not checkpoint.config:
        raise ModelError(f"{network}: holds no configuration: give --config FILE")
    source, graph = config or network, Graph()
    content = read_config(source, "" if config else checkpoint.config)
    with _named(source):
        model = openpcdet_model(content, given) if "MODEL" in content else mmdet3d_model(content, given)
        add_network(graph, model, checkpoint.weights)
    specs = model.specs
    inputs = (KIT_INPUTS[0], FLOAT, ("points", len(specs.features))), (KIT_INPUTS[1], INT64, ("points", 1))
    outputs = (KIT_OUTPUTS[0], FLOAT, ("boxes", 8)), (KIT_OUTPUTS[1], FLOAT, ("boxes", len(specs.classes)))
    return graph.file(inputs, outputs, {KEY: specs.model_dump_json()}), specs


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name the faulty configuration in errors, all of which become ModelErrors."""
    try:
        yield
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as err:
        found = f"no {err}" if isinstance(err, KeyError) else one_line(err, max_characters=300)
        if isinstance(err, ValidationError):
            first = err.errors()[0]
            found = ".".join(map(str, (err.title, *first["loc"]))) + f": {one_line(first['msg'])}"
        raise ModelError(f"{path}: expected a configuration of OpenPCDet or mmdetection3d, found {found}") from err
