"""Devices that run a network: the processor, or an accelerator by a provider of onnxruntime.

CUDA comes in two ways: built into onnxruntime (`onnxruntime-gpu`, in place of the plain package), or as a plug-in
beside the plain one (`onnxruntime-ep-cuda12` and `-cuda13`, both with the module `onnxruntime_ep_cuda`; onnxruntime.ai,
"Plugin Execution Provider Libraries").
"""

import os
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Provider
from lidcam.pipeline.core.text import one_line

MAX_MEMORY_BYTES = 4 << 30
"""Maximum memory of all networks together on the processor, including their weights."""

PROVIDERS: dict[Provider, str] = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "migraphx": "MIGraphXExecutionProvider",
    "directml": "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
}
"""Names in onnxruntime."""

PLUGIN = "onnxruntime_ep_cuda"
"""Module of the plug-in for CUDA."""

REMEDIES = {
    "cuda": (
        "pip install 'lidcam[cuda]' (for CUDA 12: onnxruntime-ep-cuda12), or replace onnxruntime with onnxruntime-gpu"
    ),
    "tensorrt": "pip install onnxruntime-gpu in place of onnxruntime",
    "openvino": "pip install onnxruntime-openvino in place of onnxruntime",
    "migraphx": "pip install onnxruntime-migraphx in place of onnxruntime",
    "directml": "pip install onnxruntime-directml in place of onnxruntime",
}


@cache
def onnxruntime() -> Any:
    """The library, imported where a network runs and nowhere else.

    Its wheels for Linux would make an id of the machine and a store of events in the home folder, and send them to
    their maker. The variable counts only if it is set before the import.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime as ort

    ort.disable_telemetry_events()
    memory = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    ort.create_and_register_allocator(memory, ort.OrtArenaCfg({"max_mem": MAX_MEMORY_BYTES}))
    return ort


@cache
def cuda_plugin() -> str:
    """The name of the provider of the plug-in for CUDA, registered with onnxruntime; empty where it is not installed.

    Raises ModelError if it does not fit onnxruntime, or its libraries are missing.
    """
    try:
        plugin = import_module(PLUGIN)
    except ImportError as err:
        if err.name != PLUGIN:
            raise ModelError(f"{PLUGIN}: cannot be imported: {one_line(err)}") from err
        return ""
    name = str(plugin.get_ep_name())
    try:
        onnxruntime().register_execution_provider_library(name, plugin.get_library_path())
    except Exception as err:  # onnxruntime's errors have no base of their own
        raise ModelError(f"{PLUGIN}: its library cannot be loaded: {one_line(err)}; check CUDA, or set cpu") from err
    return name


def chosen(provider: Provider) -> Provider:
    """The provider that `auto` stands for on this machine: `cuda` where a device can be used, else `cpu`."""
    if provider != "auto":
        return provider
    try:
        return "cuda" if _cuda_devices() else "cpu"
    except ModelError:
        return "cpu"


def _cuda_devices() -> list[Any]:
    """The devices of a provider for CUDA, which the plug-in or onnxruntime itself has."""
    names = {cuda_plugin() or PROVIDERS["cuda"]}
    return [device for device in onnxruntime().get_ep_devices() if device.ep_name in names]


def set_up(provider: Provider, options: Any) -> list[str] | None:
    """Have a session run on a provider.

    Args:
        provider: Any but `auto`.
        options: Options of the session; a device of the plug-in is added to them.

    Returns:
        The providers of the session by name, the preferred one first; None where the options name them.

    Raises:
        ModelError: there is no such provider, or no device for it.
    """
    if provider != "cuda" or not (plugin := cuda_plugin()):
        return providers_for(provider, onnxruntime().get_available_providers())
    devices = _cuda_devices()
    if not devices:
        raise ModelError(f"provider: expected a device for cuda, {plugin} finds none; check its driver, or set cpu")
    options.add_provider_for_devices(devices[:1], {})
    return None


def providers_for(provider: Provider, available: Sequence[str]) -> list[str]:
    """The providers for onnxruntime, the preferred one first, or a ModelError if that is not available.

    The processor runs what an accelerator has no kernel for.
    """
    if PROVIDERS[provider] not in available:
        has = ", ".join(name for name, known in PROVIDERS.items() if known in available)
        remedy = f"; {REMEDIES[provider]}" if provider in REMEDIES else ""
        raise ModelError(f"device: the installed onnxruntime runs on {has}, expected {provider}{remedy}")
    return [PROVIDERS[provider]] if provider == "cpu" else [PROVIDERS[provider], PROVIDERS["cpu"]]


def check_runs_on(provider: Provider, used: Sequence[str]) -> None:
    """Raise ModelError unless a network runs on the wanted provider: onnxruntime falls back to the processor."""
    names = {PROVIDERS[provider], *([cuda_plugin()] if provider == "cuda" else [])}
    if names.isdisjoint(used):
        raise ModelError(
            f"provider: {provider} cannot be used on this machine; check its driver and libraries, or set cpu"
        )
