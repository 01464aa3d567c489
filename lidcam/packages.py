"""lidcam's other packages have common names: another folder called `pipeline` on the path would be imported instead.

Loaded before signals end a program well, so it does without pathlib and typing, which take long to load.
"""
# ruff: noqa: PTH118, PTH120 (without pathlib, see above)

import os
import sys
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from types import TracebackType

__all__ = ["ForeignPackageError", "check_own_packages"]

HOME = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
PACKAGES = ("pipeline", "readers", "writers", "bags")


class ForeignPackageError(ImportError):
    """A package of another project hides one of lidcam's."""


def check_own_packages() -> None:
    """Look where the packages would be imported from.

    A script that ends with the error prints its one line, without a traceback.

    Raises:
        ForeignPackageError: one would come from elsewhere.
    """
    for name in PACKAGES:
        spec = find_spec(name)
        found = [] if spec is None else [os.path.realpath(place) for place in spec.submodule_search_locations or ()]
        own = os.path.join(HOME, name)
        if found != [own]:
            place = ", ".join(found) or (spec.origin if spec and spec.origin else "nothing")
            sys.excepthook = partial(_one_line, sys.excepthook)
            raise ForeignPackageError(
                f"lidcam: error: expected its package {name!r} in {own}, found {place}: "
                "rename that folder, take it off PYTHONPATH, or start from another folder"
            )


def _one_line(
    hook: Callable[[type[BaseException], BaseException, TracebackType | None], object],
    kind: type[BaseException],
    error: BaseException,
    trace: TracebackType | None,
) -> None:
    if isinstance(error, ForeignPackageError):
        sys.stderr.write(f"{error}\n")
    else:
        hook(kind, error, trace)
