"""Recorded lidar and camera topics in, fused objects out.

    import lidcam

    run = lidcam.process("drive.bag", "out.mcap", model_2d="yolox_nano.onnx")
    run.objects.to_pandas()

The names are those of `lidcam.api`. They are loaded when they are first used, so `import lidcam` is instant.
"""

import sys


def _interrupted(
    kind: "type[BaseException]",
    error: BaseException,
    trace: "TracebackType | None",
    /,
    *,
    other: "Any" = sys.excepthook,
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        sys.stderr.write("lidcam: interrupted\n")
    else:
        other(kind, error, trace)


_excepthook, sys.excepthook = sys.excepthook, _interrupted  # for Ctrl-C within the next lines

from lidcam.packages import check_own_packages  # noqa: E402  # behind the hook, which is for it

check_own_packages()
sys.excepthook = _excepthook

TYPE_CHECKING = False  # not from `typing`: a program should soon be so far that signals end it well

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Any

    from lidcam.api import *  # noqa: F403

else:

    def __getattr__(name: str) -> "Any":
        from lidcam.start.compiling import compiled_together

        with compiled_together():
            import lidcam.api as api

        if name not in {"api", "__all__", *api.__all__}:
            raise AttributeError(f"module 'lidcam' has no attribute {name!r}")
        value = globals()[name] = api if name == "api" else getattr(api, name)
        return value


def __dir__() -> list[str]:
    import lidcam.api

    return sorted(lidcam.api.__all__)
