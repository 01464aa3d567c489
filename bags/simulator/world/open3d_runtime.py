"""Makes Open3D importable on machines without libusb.

The wheel of Open3D 0.20 links against libusb-1.0 (for depth cameras, which lidcam never opens). Desktops have it, bare
containers do not, and installing it needs root. The package `libusb-package` ships a build that, once loaded, satisfies
the dynamic linker.
"""

import ctypes

import libusb_package

__all__ = ["load_libusb"]


def load_libusb() -> None:
    """Load libusb; call it before `import open3d`.

    Raises:
        OSError: the library cannot be loaded.
    """
    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
