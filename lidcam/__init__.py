"""Recorded lidar and camera topics in, fused objects out.

    import lidcam

    run = lidcam.process("drive.bag", "out.mcap", model_2d="yolox-nano")
    run.objects.to_pandas()

The names are those of `lidcam.api`. They are loaded when they are first used, so `import lidcam` is instant.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

HOME = Path(__file__).resolve().parents[1]
PACKAGES = ("pipeline", "readers", "writers", "bags")
"""Common names: another folder of that name on the path would be imported instead."""


def _check_own_packages() -> None:
    """Look where the packages would be imported from.

    Raises:
        ImportError: one would come from elsewhere.
    """
    for name in PACKAGES:
        spec = find_spec(name)
        found = [] if spec is None else [Path(place).resolve() for place in spec.submodule_search_locations or ()]
        if found != [HOME / name]:
            place = ", ".join(map(str, found)) or (spec.origin if spec and spec.origin else "nothing")
            raise ImportError(
                f"lidcam: expected its package {name!r} in {HOME / name}, found {place}: rename that folder, take it "
                "off PYTHONPATH, or start from another folder"
            )


_check_own_packages()

if TYPE_CHECKING:
    from lidcam.api import *  # noqa: F403

else:

    def __getattr__(name: str) -> Any:
        from lidcam.compiling import compiled_together

        with compiled_together():
            import lidcam.api as api

        if name not in {"api", "__all__", *api.__all__}:
            raise AttributeError(f"module 'lidcam' has no attribute {name!r}")
        value = globals()[name] = api if name == "api" else getattr(api, name)
        return value


def __dir__() -> list[str]:
    import lidcam.api

    return sorted(lidcam.api.__all__)
