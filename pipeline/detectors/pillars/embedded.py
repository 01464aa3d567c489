"""The 3D networks that come with lidcam."""

from os.path import isfile
from pathlib import Path

from lidcam.pipeline.core.errors import ModelError

EMBEDDED = {name: Path(__file__).with_name(f"{name}.onnx") for name in ("traffic", "sandbox")}
"""Files by name: for road users of full size, and for model cars. The `.md` file beside each is its card."""


def network_file(model: Path) -> Path:
    """The file of the network that the settings give by path or by a name in `EMBEDDED`. It may be missing."""
    return EMBEDDED.get(str(model), model)


def existing_network_file(model: Path) -> Path:
    """The file of a network, as `network_file`; raises ModelError if it is missing."""
    path = network_file(model)
    if not isfile(path):  # noqa: PTH113  # Path.is_file may raise
        names = ", ".join(EMBEDDED)
        raise ModelError(f"{path}: expected an ONNX file, or a network that comes with lidcam ({names}), found none")
    return path
