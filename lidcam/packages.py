"""lidcam's other packages have common names: another folder called `pipeline` on the path would be imported instead."""

from importlib.util import find_spec
from pathlib import Path

__all__ = ["check_own_packages"]

HOME = Path(__file__).resolve().parents[1]
PACKAGES = ("pipeline", "readers", "writers", "bags")


def check_own_packages() -> None:
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
