"""2D networks that lidcam knows by name."""

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lidcam.pipeline.core.errors import ModelError

NetworkName = Literal["yolox-nano", "yolox-tiny", "yolox-s"]


@dataclass(frozen=True, slots=True)
class KnownNetwork:
    """A file that the maker of a network publishes."""

    address: str  # URL, from where the user may also take it by hand
    size_bytes: int  # Size
    sha256: str  # Checksum, in hexadecimal digits
    licence: str  # SPDX identifier of the licence
    licence_address: str  # URL of the licence's text

    @property
    def file_name(self) -> str:
        """The name of the file."""
        return self.address.rpartition("/")[2]


def _yolox(file_name: str, size_bytes: int, sha256: str) -> KnownNetwork:
    home = "https://github.com/Megvii-BaseDetection/YOLOX"
    address = f"{home}/releases/download/0.1.1rc0/{file_name}"
    return KnownNetwork(address, size_bytes, sha256, "Apache-2.0", f"{home}/blob/0.1.1rc0/LICENSE")


NETWORKS: dict[str, KnownNetwork] = {
    "yolox-nano": _yolox(
        "yolox_nano.onnx", 3_659_407, "c789161ed43c8269fcd4e67c67eeeb4e80c622da2eb296a20bc6007bd18a0b7d"
    ),
    "yolox-tiny": _yolox(
        "yolox_tiny.onnx", 20_219_662, "427cc366d34e27ff7a03e2899b5e3671425c262ea2291f88bb942bc1cc70b0f7"
    ),
    "yolox-s": _yolox("yolox_s.onnx", 35_858_002, "c5c2d13e59ae883e6af3b45daea64af4833a4951c92d116ec270d9ddbe998063"),
}
"""By name, more precise ones later. The maker publishes no checksums; many projects have recorded these."""


def networks_folder() -> Path:
    """Folder of fetched networks: in the user's data folder (XDG Base Directory Specification).

    Raises:
        ModelError: this user has none.
    """
    data = Path(os.environ.get("XDG_DATA_HOME") or "")
    try:
        return (data if data.is_absolute() else Path.home() / ".local" / "share") / "lidcam" / "networks"
    except RuntimeError as err:
        raise ModelError("networks: this user has no home folder: let XDG_DATA_HOME name a folder for them") from err


def fetched_network() -> Path | None:
    """The name of the most precise network that the user has fetched, by name and size of the files; None without."""
    for name, network in reversed(NETWORKS.items()):
        with suppress(ModelError, OSError):  # no home folder, or one that nobody may look into
            path = network_path(Path(name))
            if path.stat().st_size == network.size_bytes and os.access(path, os.R_OK):
                return Path(name)
    return None


def network_path(model: Path) -> Path:
    """The file of a network that settings name: its path, or a name in `NETWORKS`. It may be missing.

    Raises:
        ModelError: as of `networks_folder`.
    """
    known = NETWORKS.get(str(model))
    return model if known is None else networks_folder() / known.file_name
