"""Conversion of a kit's checkpoint or exported network to a file that `--model-3d` takes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnx
from pydantic import ValidationError

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.detectors.onnx.session import OnnxSession
from lidcam.pipeline.detectors.pillars.kits import KEY, KIT_INPUTS, KIT_OUTPUTS, KitSpecs
from lidcam.training.kits.files import read_checkpoint, read_config
from lidcam.training.kits.graph import Rows, Weights, add_anchor_boxes, add_network, by_row
from lidcam.training.kits.mmdet3d import mmdet3d_model
from lidcam.training.kits.model import AnchorHead, Data, KitModel
from lidcam.training.kits.openpcdet import openpcdet_model
from lidcam.training.onnx_graph import FLOAT, INT64, Graph, Value

MMDEPLOY = "cls_score", "bbox_pred", "dir_cls_pred"
EXPORTS: dict[tuple[str, ...], tuple[tuple[str, ...], ...]] = {
    ("voxels", "num_points", "coors"): (MMDEPLOY, tuple(f"{name}0" for name in MMDEPLOY)),
    ("voxels", "voxel_num_points", "voxel_coords"): (("cls_preds", "box_preds", "dir_cls_preds"),),
}
"""Outputs by inputs: for mmdeploy, and for exports with the names of OpenPCDet's modules, with channels last."""


class Converted(NamedTuple):
    """Content of a file for `--model-3d`, and the metadata in it."""

    content: bytes
    specs: KitSpecs


def converted(network: Path, config: Path | None, given: Data) -> Converted:
    """Convert a network.

    Args:
        network: Checkpoint, or ONNX file.
        config: Configuration; None: the one that mmdetection3d put into the checkpoint.
        given: Values that take precedence over those known for the data set.

    Raises:
        ModelError: a file cannot be read, or lidcam cannot run the network.
    """
    if network.suffix == ".onnx":
        if config is None:
            raise ModelError(f"{network}: an exported network needs its configuration: --config FILE")
        return _exported(network, _model(config, "", given))
    checkpoint = read_checkpoint(network)
    if config is None and not checkpoint.config:
        raise ModelError(f"{network}: holds no configuration: give --config FILE")
    source = config or network
    model = _model(source, "" if config else checkpoint.config, given)
    graph, weights, specs = Graph(), Weights(checkpoint.weights), model.specs
    with _named(source):
        add_network(graph, model, weights)
        weights.check_none_left()
    inputs = (KIT_INPUTS[0], FLOAT, ("points", len(specs.features))), (KIT_INPUTS[1], INT64, ("points", 1))
    return Converted(graph.file(inputs, _outputs(specs), {KEY: specs.model_dump_json()}), specs)


def _model(path: Path, text: str, given: Data) -> KitModel:
    config = read_config(path, text)
    with _named(path):
        return openpcdet_model(config, given) if "MODEL" in config else mmdet3d_model(config, given)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name the faulty configuration in errors.

    Raises:
        ModelError: one was raised without the name, or a value is missing or unexpected.
    """
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


def _exported(path: Path, model: KitModel) -> Converted:
    """The exported network, followed by nodes that turn its outputs into boxes."""
    session, head = OnnxSession(path, threads=1, provider="cpu"), model.head
    inputs, outputs = (tuple(name for name, _, _ in values) for values in (session.inputs, session.outputs))
    if not isinstance(head, AnchorHead) or outputs not in EXPORTS.get(inputs, ()):
        expected = " or ".join(f"{', '.join(ins)} -> {', '.join(outs[-1])}" for ins, outs in EXPORTS.items())
        found = f"{', '.join(inputs)} -> {', '.join(outputs)}"
        raise ModelError(f"{path}: expected PointPillars with {expected}, found {type(head).__name__}, {found}")
    graph, channels_last = Graph("lidcam/"), outputs[0] == "cls_preds"
    counts = len(model.specs.classes), head.code, head.directions
    rows = [
        graph.add_node("Reshape", name, np.array([-1, numbers])) if channels_last else by_row(graph, name, numbers)
        for name, numbers in zip(outputs, counts, strict=True)
    ]
    with _named(path):
        add_anchor_boxes(graph, model, head, Rows(*rows))
    specs = model.specs.model_copy(update={"layout": "voxels", "features": tuple(model.raw)})
    return Converted(graph.file_behind(onnx.load(path), _outputs(specs), {KEY: specs.model_dump_json()}), specs)


def _outputs(specs: KitSpecs) -> tuple[Value, Value]:
    return (KIT_OUTPUTS[0], FLOAT, ("boxes", 8)), (KIT_OUTPUTS[1], FLOAT, ("boxes", len(specs.classes)))
