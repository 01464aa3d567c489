"""What an output says of how it was made."""

from hashlib import sha256
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from onnx_files import write_yolox

import lidcam

SANDBOX = Path(__file__).resolve().parents[3] / "bags/sandbox.bag"


def said(path: Path) -> dict[str, str]:
    with path.open("rb") as file:
        return {
            key: value
            for record in make_reader(file).iter_metadata()
            for key, value in record.metadata.items()
            if key.startswith("network.")
        }


def test_the_network_and_what_ran_it(tmp_path: Path) -> None:
    path = write_yolox(tmp_path / "net.onnx", np.zeros((84, 85), np.float32), size_px=(64, 64))
    out = tmp_path / "out.mcap"
    settings = {"output.images": False, "output.clouds": False}
    lidcam.process(SANDBOX, out, model_2d=path, settings=settings, duration_s=0.1, workers=1)
    checksum = sha256(path.read_bytes()).hexdigest()
    assert said(out) == {"network.name": "net.onnx", "network.sha256": checksum, "network.provider": "cpu"}
