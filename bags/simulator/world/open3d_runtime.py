"""Open3D on a machine without libusb.

The wheel of Open3D 0.20 is linked against libusb-1.0 (for depth cameras, which lidcam never opens). A desktop has it, a
bare container does not, and installing it needs root. The package `libusb-package` carries a build: once it is loaded,
the dynamic linker takes it for Open3D's.
"""

import ctypes

import libusb_package

__all__ = ["load_libusb"]


def load_libusb() -> None:
    """Make libusb known to the dynamic linker; call it before `import open3d`.

    Raises:
        OSError: the library cannot be loaded.
    """
    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
