"""What an output says of how it was made."""

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from onnx_files import write_yolox

import lidcam
from readers.results.result import open_result

SANDBOX = Path(__file__).resolve().parents[3] / "bags/sandbox.bag"


def said(path: Path, about: str) -> dict[str, str]:
    with path.open("rb") as file:
        return {
            key: value
            for record in make_reader(file).iter_metadata()
            for key, value in record.metadata.items()
            if key.startswith(about)
        }


def test_the_network_and_what_ran_it(tmp_path: Path) -> None:
    path = write_yolox(tmp_path / "net.onnx", np.zeros((84, 85), np.float32), size_px=(64, 64))
    out = tmp_path / "out.mcap"
    settings = {"output.images": False, "output.clouds": False}
    lidcam.process(SANDBOX, out, model_2d=path, settings=settings, duration_s=0.1, workers=1)
    checksum = sha256(path.read_bytes()).hexdigest()
    assert said(out, "network.") == {"network.name": "net.onnx", "network.sha256": checksum, "network.provider": "cpu"}


@pytest.mark.parametrize(("start_s", "duration_s"), [(0.0, 0.1), (1.9, None), (0.0, 60.0)])
def test_the_recording(tmp_path: Path, start_s: float, duration_s: float | None) -> None:
    out, whole = tmp_path / "out.mcap", SANDBOX.read_bytes()
    settings = {"output.images": False, "output.clouds": False}
    lidcam.process(SANDBOX, out, settings=settings, start_s=start_s, duration_s=duration_s, workers=1)
    known = {"input.0.name": "sandbox.bag", "input.0.size": str(len(whole))}
    if duration_s == 60.0:
        known["input.0.sha256"] = sha256(whole).hexdigest()
    assert said(out, "input.") == known
    with open_result(out) as result:
        assert known.items() <= result.metadata.items()
