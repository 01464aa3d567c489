"""A simulated recording from pixels to objects, in a world that the 2D network was not trained on."""

import json
from pathlib import Path

from command import Lidcam


def test_a_sample_is_processed_from_its_pixels(crossing: Path, lidcam: Lidcam, tmp_path: Path) -> None:
    """The network that comes with lidcam knows cars above all."""
    out = tmp_path / "out.mcap"
    less = ("--duration", "0.5", "--set", "output.images=false", "--json")
    run = lidcam("process", crossing, out, "--model-2d", "simulated", *less)
    assert run.code == 0, run.err
    assert json.loads(run.out)["box_source"] == "onnx"
    figures = json.loads(lidcam("evaluate", out, "--json").out)
    images = [camera["car"] for camera in figures["images"].values()]
    assert sum(one["right"] for one in images) >= 0.6 * sum(one["truth"] for one in images) > 5
    assert figures["sources"]["fused"]["car"]["recall"] > 0.6
    assert figures["sources"]["fused"]["car"]["precision"] > 0.9
