"""Recorded lidar and camera topics in, fused objects out.

    import lidcam

    run = lidcam.process("drive.bag", "out.mcap", model_2d="yolox_nano.onnx")
    run.objects.to_pandas()

The names are those of `lidcam.api`. They are loaded when they are first used, so `import lidcam` is instant.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lidcam.api import *  # noqa: F403

else:

    def __getattr__(name: str) -> Any:
        from lidcam.packages import check_own_packages

        check_own_packages()
        api = import_module("lidcam.api")
        if name != "__all__" and name not in api.__all__:
            raise AttributeError(f"module 'lidcam' has no attribute {name!r}")
        return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *import_module("lidcam.api").__all__})
