"""`lidcam train convert`: networks of both kits run as they do in PyTorch, and what is refused is named.

No trained weights of the kits can be had here: these networks are small, random, and have the kits' names and shapes.
"""

# ruff: noqa: E402  # without torch the file is skipped before it imports what needs it

import json
import os
from collections.abc import Callable
from contextlib import nullcontext
from copy import deepcopy
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
import yaml
from helpers import SANDBOX

torch = pytest.importorskip("torch", reason="needs the extra train")

from kit_networks import CONFIGS, MMDET3D, MOST, OPENPCDET, RANGE, KitNet
from typer.testing import CliRunner

import lidcam
from lidcam.cli import app
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.onnx.session import OnnxSession
from lidcam.pipeline.detectors.pillars.kits import KitNetwork
from lidcam.training.kits.convert import converted
from lidcam.training.kits.model import Data

NOTHING = Data(None, None)


def points() -> F64:
    """(P, 4) of which no pillar has more than `MOST`, and many have fewer."""
    draw = np.random.default_rng(0)
    drawn = draw.uniform([*RANGE[:3], 0], [*RANGE[3:], 1], (300, 4))
    cell = np.floor(drawn[:, 0] / 0.5) * 16 + np.floor((drawn[:, 1] + 4) / 0.5)
    order = np.argsort(cell, kind="stable")
    _, starts, counts = np.unique(cell[order], return_index=True, return_counts=True)
    within = np.arange(len(cell)) - np.repeat(starts, counts)
    return np.asarray(drawn[order[within < MOST]])


def written(path: Path, config: dict[str, Any], form: str) -> Path:
    """A file of OpenPCDet (`yaml`), or of mmdetection3d."""
    texts: dict[str, Callable[[dict[str, Any]], str]] = {"yaml": yaml.safe_dump, "json": json.dumps, "py": python_file}
    path = path / f"config.{form}"
    path.write_text(texts[form](config), encoding="utf-8")
    return path


def python_file(config: dict[str, Any]) -> str:
    """As mmengine prints it, behind lines that are no literals."""
    lines = "".join(f"{key} = {python(value)}\n" for key, value in config.items())
    return f"Config:\nran = open('ran', 'w')\nlr = 0.1 * 2\n{lines}"


def python(value: object) -> str:
    if isinstance(value, dict):
        return f"dict({', '.join(f'{key}={python(one)}' for key, one in value.items())})"
    return f"({', '.join(map(python, value))},)" if isinstance(value, list) else repr(value)


@pytest.mark.parametrize("name", CONFIGS)
def test_the_file_finds_what_the_network_finds(tmp_path: Path, name: str) -> None:
    """Against PyTorch, with the ground at 0 and intensities as they are."""
    net, made = KitNet(name), points()
    config = written(tmp_path, net.config, "yaml" if name.startswith("O") else "py")
    held = {"model_state": net.state, "epoch": 80, "version": "pcdet+0.6.0"}
    if name.startswith("m"):
        held = {"state_dict": {f"module.{key}": one for key, one in net.state.items()}, "meta": {"epoch": 1}}
    torch.save(held, tmp_path / "net.pth", _use_new_zipfile_serialization=not name.startswith("O"))
    content, _ = converted(tmp_path / "net.pth", config, Data(0.0, 1.0))
    assert content == converted(tmp_path / "net.pth", config, Data(0.0, 1.0))[0]
    assert not list(tmp_path.glob("ran"))
    (path := tmp_path / "net.onnx").write_bytes(content)
    found = KitNetwork(path, OnnxSession(path))(made[:, :3], made[:, 3].astype(np.float32), -1e9)
    boxes, odds = net.boxes(made)
    order = np.argsort(-odds.max(1), kind="stable")
    assert len(found.yaws) == len(boxes)
    mine = np.argsort(-found.log_odds, kind="stable")
    np.testing.assert_allclose(found.log_odds[mine], odds.max(1)[order], atol=1e-4)
    assert (found.classes[mine] == odds.argmax(1)[order]).all()
    np.testing.assert_allclose(found.centers[mine], boxes[order, :3], atol=1e-4)
    np.testing.assert_allclose(found.sizes[mine], boxes[order, 3:6], rtol=1e-4)
    np.testing.assert_allclose(np.cos(found.yaws[mine] - boxes[order, 6]), 1, atol=1e-6)


def saved(path: Path, net: KitNet) -> Path:
    torch.save({"model_state": net.state}, path / "net.pth")
    return path / "net.pth"


def changed(config: dict[str, Any], place: str, value: object) -> dict[str, Any]:
    """A copy with another value at a place, or without it (None)."""
    copy = deepcopy(config)
    *way, last = place.split(".")
    section = copy
    for key in way:
        section = section[key]
    if value is None:
        del section[last]
    else:
        section[last] = value
    return copy


@pytest.mark.parametrize(
    ("name", "weights", "expected"),
    [
        ("dense_head.conv_box.bias", None, r"dense_head\.conv_box\.bias \(28,\) in the checkpoint, found none$"),
        ("vfe.pfn_layers.0.linear.weight", torch.zeros(4, 9), r"weight \(4, 10\) in the checkpoint, found \(4, 9\)$"),
        ("global_step", torch.zeros(1), None),
    ],
)
def test_weights_that_do_not_fit_are_named(tmp_path: Path, name: str, weights: Any, expected: str | None) -> None:
    state = {key: one for key, one in (KitNet("OpenPCDet, anchors").state | {name: weights}).items() if one is not None}
    torch.save(state, tmp_path / "net.pth")
    config = written(tmp_path, OPENPCDET, "yaml")
    with pytest.raises(ModelError, match=f"config.yaml: expected .*{expected}") if expected else nullcontext():
        converted(tmp_path / "net.pth", config, NOTHING)


@pytest.mark.parametrize(
    ("config", "place", "value", "message"),
    [
        (OPENPCDET, "MODEL.BACKBONE_3D", {"NAME": "VoxelBackBone8x"}, r"BACKBONE_3D VoxelBackBone8x \(sparse conv"),
        (OPENPCDET, "MODEL.DENSE_HEAD", None, "with no DENSE_HEAD"),
        (OPENPCDET, "MODEL.VFE.NUM_FILTERS", [10**9], r"expected weights vfe\.\S+ \(1000000000, 10\)"),
        (OPENPCDET, "DATA_CONFIG.DATASET", "MyDataset", "expected --ground-z and --intensity-max"),
        (OPENPCDET, "DATA_CONFIG._BASE_CONFIG_", "cfgs/none.yaml", r"found no file cfgs/none\.yaml, on which"),
        (MMDET3D, "model.middle_encoder.type", "SparseEncoder", r"SparseEncoder \(sparse convolutions\)"),
        (MMDET3D, "model.backbone.norm_cfg", {"type": "GN"}, r"norm_cfg\.type: expected BN, .* found GN"),
        (MMDET3D, "_base_", ["../a.py"], "with all of it in one file"),
    ],
)
def test_what_is_not_run(tmp_path: Path, config: dict[str, Any], place: str, value: object, message: str) -> None:
    net = KitNet("OpenPCDet, anchors" if config is OPENPCDET else "mmdetection3d, anchors")
    form = "yaml" if config is OPENPCDET else "json"
    with pytest.raises(ModelError, match=message):
        converted(saved(tmp_path, net), written(tmp_path, changed(config, place, value), form), NOTHING)


def test_configurations_with_a_base(tmp_path: Path) -> None:
    """As in OpenPCDet: a network's file names one of the data set from the folder above `cfgs`, and changes some."""
    (tmp_path / "cfgs" / "models").mkdir(parents=True)
    base = OPENPCDET["DATA_CONFIG"] | {"POINT_CLOUD_RANGE": [0, 0, 0, 1, 1, 1]}
    (tmp_path / "cfgs" / "data.yaml").write_text(yaml.safe_dump(base), encoding="utf-8")
    own = {"_BASE_CONFIG_": "cfgs/data.yaml", "POINT_CLOUD_RANGE": RANGE}
    config = written(tmp_path / "cfgs" / "models", OPENPCDET | {"DATA_CONFIG": own}, "yaml")
    _, specs = converted(saved(tmp_path, KitNet("OpenPCDet, anchors")), config, NOTHING)
    assert (specs.grid.low_m, specs.grid.cells, specs.ground_z_m, specs.intensity_max) == (
        (0, -4, -3),
        (16, 16),
        -1.73,
        1,
    )


class Log:
    """An object of a class that is none of PyTorch's, as mmengine puts beside the weights."""


class Bomb:
    def __init__(self, call: object, *arguments: object) -> None:
        self.call, self.arguments = call, arguments

    def __reduce__(self) -> Any:
        return self.call, self.arguments


def test_nothing_in_a_checkpoint_is_run(tmp_path: Path) -> None:
    """Its configuration is read from it; other objects are left out, and what would call something is not called."""
    net = KitNet("mmdetection3d, anchors")
    meta = {"cfg": python_file(MMDET3D).removeprefix("Config:\n"), "mmdet3d_version": "1.4.0"}
    log = Log()
    log.values = np.arange(3.0)  # type: ignore[attr-defined]  # as objects have
    bombs = [Bomb(open, str(tmp_path / "ran"), "w"), Bomb(getattr, log, "values"), log]
    torch.save({"state_dict": net.state, "meta": meta, "message_hub": bombs}, tmp_path / "net.pth")
    assert converted(tmp_path / "net.pth", None, NOTHING)[1].features[:2] == ("dx_cell", "dy_cell")
    assert not (tmp_path / "ran").exists()


DEFLATED = "deflated"
"""A checkpoint of zeros that somebody has compressed."""

DOUBLED: list[object] = ["text"]
for _ in range(60):
    DOUBLED = [DOUBLED, DOUBLED]


@pytest.mark.parametrize(
    ("held", "is_new", "message"),
    [
        ({"model_state": {}, "x": Bomb(os.system, "touch ran")}, True, "expected a checkpoint of .*, found .* posix"),
        ({"model_state": {}, "x": Bomb(os.system, "touch ran")}, False, "expected a checkpoint of .*, found .* posix"),
        (
            {"state_dict": {}, "meta": {"mmdet3d_version": "0.17.1"}},
            True,
            r"mmdetection3d 1\.0 or later, found 0\.17\.1",
        ),
        ({"state_dict": {}}, True, "holds no configuration: give --config FILE"),
        (None, True, "found no such file"),
        (b"", True, "expected a checkpoint of"),
        ({"state_dict": {"a": torch.zeros(1).expand(1 << 30)}}, True, "found ValueError: layers of 1073741824 numbers"),
        ({"state_dict": {}, "meta": {"cfg": DOUBLED}}, True, "holds no configuration: give --config FILE"),
        (DEFLATED, True, r"found ValueError: 0\.1 MiB that would be 95 when unpacked"),
        ("fifo", True, "found OSError: .* found a FIFO or a device"),
    ],
)
def test_files_that_are_no_checkpoints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, held: object, is_new: bool, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if held == "fifo":
        os.mkfifo("net.pth")
    elif held == DEFLATED:
        torch.save({"state_dict": {"a": torch.zeros(25_000_000)}}, "stored")
        with ZipFile("stored") as stored, ZipFile("net.pth", "w", ZIP_DEFLATED) as deflated:
            for name in stored.namelist():
                deflated.writestr(name, stored.read(name))
    elif isinstance(held, bytes):
        (tmp_path / "net.pth").write_bytes(held)
    elif held is not None:
        torch.save(held, tmp_path / "net.pth", _use_new_zipfile_serialization=is_new)
    with pytest.raises(ModelError, match=message):
        converted(tmp_path / "net.pth", None, NOTHING)
    assert not (tmp_path / "ran").exists()
    (tmp_path / "net.onnx").write_bytes(b"\x08\x08\x12\x07pytorch")
    with pytest.raises(ModelError, match=r"found an ONNX network$"):
        converted(tmp_path / "net.onnx", None, NOTHING)


def test_the_command(tmp_path: Path) -> None:
    """Takes some seconds: what it writes is used."""
    config, out = written(tmp_path, OPENPCDET, "yaml"), tmp_path / "net.onnx"
    command = ["train", "convert", saved(tmp_path, KitNet("OpenPCDet, anchors")), "--config", config, "--out", out]
    done = CliRunner().invoke(app, [*map(str, command)])
    assert done.exit_code == 0, done.exception
    assert done.stdout.splitlines()[1:] == ["x from 0 to 8 m, y from -4 to 4 m", "ground at -1.73 m, intensities to 1"]
    run = lidcam.process(SANDBOX, model_3d=out, config="road", duration_s=0.3, workers=1)
    assert (run.summary.sensors.box_source_3d, run.summary.frames.count > 1) == ("combined", True)
