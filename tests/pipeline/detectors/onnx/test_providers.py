"""What runs a network, by the interface of plug-ins: the processor stands for the device, which no machine here has."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import onnxruntime
import pytest
from onnx_files import write_yolox

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import Provider
from lidcam.pipeline.detectors.onnx import providers
from lidcam.pipeline.detectors.onnx.providers import check_runs_on, chosen, cuda_plugin, providers_for
from lidcam.pipeline.detectors.onnx.session import OnnxSession
from lidcam.pipeline.detectors.pillars.embedded import EMBEDDED
from lidcam.run.box_sources import with_device
from lidcam.run.job import make_job

CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"
NO_LIBRARY = "/nowhere/libonnxruntime_providers_cuda.so"


@pytest.fixture(autouse=True)
def _not_remembered() -> Iterator[None]:
    cuda_plugin.cache_clear()
    yield
    cuda_plugin.cache_clear()


def install(monkeypatch: pytest.MonkeyPatch, *, name: str = CUDA, is_sound: bool = False) -> list[tuple[str, str]]:
    """Put a plug-in beside onnxruntime; the registrations that it accepts, where it is sound."""
    plugin, registered = ModuleType("onnxruntime_ep_cuda"), list[tuple[str, str]]()
    plugin.get_ep_name, plugin.get_library_path = lambda: name, lambda: NO_LIBRARY  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, plugin.__name__, plugin)
    if is_sound:
        monkeypatch.setattr(onnxruntime, "register_execution_provider_library", lambda *given: registered.append(given))
    return registered


SIZE_PX = (64, 64)


def network(folder: Path) -> Path:
    write_yolox(folder / "a.onnx", np.zeros((84, 85), np.float32), size_px=SIZE_PX)
    return folder / "a.onnx"


def load(folder: Path, provider: Provider) -> OnnxSession:
    return OnnxSession(network(folder), provider=provider)


def test_providers_that_are_built_in() -> None:
    assert providers_for("cpu", [CUDA, CPU]) == [CPU]
    assert providers_for("cuda", [CUDA, CPU]) == [CUDA, CPU]
    check_runs_on("cuda", [CUDA, CPU])
    with pytest.raises(ModelError, match="cuda cannot be used on this machine"):
        check_runs_on("cuda", [CPU])


@pytest.mark.parametrize(
    ("provider", "remedy"),
    [("cuda", "; pip install 'lidcam[cuda]' (for CUDA 12: "), ("openvino", "; pip install "), ("coreml", "")],
)
def test_a_provider_that_is_missing_is_one_line(tmp_path: Path, provider: Provider, remedy: str) -> None:
    with pytest.raises(ModelError) as caught:
        load(tmp_path, provider)
    found = str(caught.value)
    assert "\n" not in found
    assert found.startswith("device: the installed onnxruntime runs on cpu, ")
    assert f"expected {provider}{remedy}" in found


def test_auto_takes_the_processor_and_says_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert load(tmp_path, "auto").provider == "cpu"
    assert capfd.readouterr() == ("", "")


def test_a_plug_in_whose_library_cannot_be_loaded_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    with pytest.raises(
        ModelError, match=r"^onnxruntime_ep_cuda: its library cannot be loaded: .*; check CUDA, or set cpu$"
    ):
        load(tmp_path, "cuda")
    assert chosen("auto") == "cpu"
    assert capfd.readouterr() == ("", "")


def test_a_plug_in_without_a_device_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    registered = install(monkeypatch, is_sound=True)
    with pytest.raises(
        ModelError, match=f"expected a device for cuda, {CUDA} finds none; check its driver, or set cpu"
    ):
        load(tmp_path, "cuda")
    assert chosen("auto") == "cpu"
    assert registered == [(CUDA, NO_LIBRARY)], "once"


@pytest.mark.parametrize("provider", ["auto", "cuda"])
def test_a_network_runs_on_the_device_of_a_plug_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, provider: Provider
) -> None:
    """The processor's own device stands for that of a plug-in: it is added to the options in the same way."""
    install(monkeypatch, name=CPU, is_sound=True)
    session = load(tmp_path, provider)
    assert session.provider == "cuda"
    images = np.zeros((1, 3, *SIZE_PX), np.float32)
    (on_device,) = session.run({session.inputs[0][0]: images}, 1)
    (expected,) = load(tmp_path, "cpu").run({session.inputs[0][0]: images}, 1)
    np.testing.assert_array_equal(on_device, expected)


def test_both_networks_get_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    config = make_job("a.bag", device="auto").config
    assert (config.detect2d.provider, config.detect3d.provider) == ("auto", "auto")
    assert with_device(config).detect3d.provider == "cpu"
    install(monkeypatch, name=CPU, is_sound=True)
    cuda_plugin.cache_clear()
    decided = with_device(config)
    assert (decided.detect2d.provider, decided.detect3d.provider) == ("cuda", "cuda")
    assert with_device(Config()) == Config(), "the processor, unless asked for"
    assert OnnxSession(EMBEDDED["traffic"], provider=decided.detect3d.provider).provider == "cuda"
    assert providers.PLUGIN == "onnxruntime_ep_cuda"
