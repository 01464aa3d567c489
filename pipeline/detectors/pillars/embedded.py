"""The 3D networks that come with lidcam."""

from pathlib import Path

__all__ = ["EMBEDDED", "network_file"]

EMBEDDED = {name: Path(__file__).with_name(f"{name}.onnx") for name in ("traffic", "sandbox")}
"""By name: for road users of full size, and for model cars. The file ending in `.md` beside each is its card."""


def network_file(model: Path) -> Path:
    """The file of a network that settings name: its path, or a name of `EMBEDDED`. It may be missing."""
    return EMBEDDED.get(str(model), model)
