"""What runs networks: the processor, or an accelerator that the installed onnxruntime knows."""

from collections.abc import Sequence

from pipeline.core.errors import ModelError
from pipeline.core.settings.detect import Provider

__all__ = ["check_runs_on", "providers_for"]

PROVIDERS: dict[Provider, str] = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "migraphx": "MIGraphXExecutionProvider",
    "directml": "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
}
"""What onnxruntime calls them."""

PACKAGES = {
    "cuda": "onnxruntime-gpu",
    "tensorrt": "onnxruntime-gpu",
    "openvino": "onnxruntime-openvino",
    "migraphx": "onnxruntime-migraphx",
    "directml": "onnxruntime-directml",
}


def providers_for(provider: Provider, available: Sequence[str]) -> list[str]:
    """What onnxruntime is told, the first first; the processor runs what an accelerator has no kernel for.

    Args:
        provider: What is wanted.
        available: What the installed onnxruntime has.

    Raises:
        ModelError: it does not have it.
    """
    if PROVIDERS[provider] not in available:
        has = ", ".join(name for name, known in PROVIDERS.items() if known in available)
        package = PACKAGES.get(provider)
        remedy = f"; pip install {package} in place of onnxruntime" if package else ""
        raise ModelError(
            f"detect2d.provider: expected {has}, which the installed onnxruntime has, found {provider}{remedy}"
        )
    return [PROVIDERS[provider]] if provider == "cpu" else [PROVIDERS[provider], PROVIDERS["cpu"]]


def check_runs_on(provider: Provider, used: Sequence[str]) -> None:
    """Whether a network that was loaded runs where it should: onnxruntime itself falls back to the processor.

    Args:
        provider: What is wanted.
        used: What onnxruntime says that the network runs on.

    Raises:
        ModelError: it does not.
    """
    if PROVIDERS[provider] not in used:
        raise ModelError(
            f"detect2d.provider: {provider} cannot be used on this machine; check its driver and libraries, or set cpu"
        )
