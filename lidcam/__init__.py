"""Recorded lidar and camera topics in, fused objects out.

    import lidcam

    run = lidcam.process("drive.bag", "out.mcap", model_2d="yolox-nano")
    run.objects.to_pandas()

The names are those of `lidcam.api`. They are loaded when they are first used, so `import lidcam` is instant.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lidcam.api import *  # noqa: F403

else:

    def __getattr__(name: str) -> Any:
        import lidcam.api as api

        if name not in {"api", "__all__", *api.__all__}:
            raise AttributeError(f"module 'lidcam' has no attribute {name!r}")
        value = globals()[name] = api if name == "api" else getattr(api, name)
        return value


def __dir__() -> list[str]:
    import lidcam.api

    return sorted(lidcam.api.__all__)
