"""Makes Open3D importable, or says what the machine lacks for it.

The wheel of Open3D 0.20 links against libusb-1.0 (for depth cameras, which lidcam never opens). Desktops have it, bare
containers do not, and installing it needs root. The package `libusb-package` ships a build that, once loaded, satisfies
the dynamic linker. The wheel also links against libraries of graphics, which no package on the index ships.
"""

import ctypes
import sys
from typing import Any

import libusb_package

from lidcam.pipeline.core.errors import LidcamError

LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libidn2.so.0": "libidn2-0",
    "libudev.so.1": "libudev1",
}
"""Libraries that the wheel for Linux links against and a bare machine may lack, with Debian's packages."""


def check_libraries() -> None:
    """Look for the system's libraries without loading Open3D; raises LidcamError if some are missing."""
    missing = [name for name in LIBRARIES if sys.platform == "linux" and not _is_there(name)]
    if missing:
        packages = " ".join(LIBRARIES[name] for name in missing)
        raise LidcamError(
            f"the simulator needs {', '.join(missing)}, against which Open3D is linked, and this machine lacks them: "
            f"apt-get install {packages}, or the same by your system's names"
        )


def load_open3d() -> Any:
    """Open3D, whose stubs lack arrays.

    Raises:
        OSError: libusb cannot be loaded.
    """
    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d


def _is_there(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
