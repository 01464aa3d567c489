"""Machine code that numba made, run without numba: to import that, with its tables of types, takes most of a second.

Beside llvmlite, which is documented, this needs what compiled functions need at run time: three modules of numba that
are written in C, and the way in which its functions are called. Neither is documented, so this is done only with
versions of numba that the tests have seen; with others, numba itself loads what it keeps.
"""

import builtins
import ctypes
import importlib.machinery
import importlib.util
import os
import pickle
import platform
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from pipeline.core.compiled.machine_code import MachineCode

__all__ = ["LinkError", "link", "made_for"]

SEEN = re.compile(rb'"version": "0\.6[378]\.\d+"')
"""Versions of numba whose functions are called as here."""

FORMAT = "1"
"""Of what is kept."""


class LinkError(Exception):
    """This process cannot run this machine code."""


@cache
def made_for() -> str | None:
    """The libraries, their settings and the processor: what machine code depends on; nothing if it cannot be linked."""
    folder = _numba_folder()
    if folder is None or not sys.platform.startswith("linux") or sys.byteorder != "little":
        return None
    try:
        version = (folder / "_version.py").read_bytes()
    except OSError:
        return None
    if SEEN.search(version) is None:
        return None
    import llvmlite
    import llvmlite.binding as llvm

    settings = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_")}
    settings.pop("NUMBA_CACHE_DIR", None)
    return "\0".join(
        [
            FORMAT,
            version.decode(),
            llvmlite.__version__,
            str(sys.implementation.cache_tag),
            platform.machine(),
            llvm.get_host_cpu_name(),
            llvm.get_host_cpu_features().flatten(),
            *(f"{name}={settings[name]}" for name in sorted(settings)),
        ]
    )


def link(code: MachineCode, name: str) -> Callable[..., Any]:
    """The function, to be called with arguments of the right types and no others.

    Args:
        code: Made as `made_for` says.
        name: Its qualified name.

    Raises:
        LinkError: it needs something that is not there.
    """
    if not _engines or not _engines[-1].has_room(code):
        _engines.append(_Engine())  # with the first one, LLVM gets to know C's library and Python's
    for symbol in code.needed:
        _provide(symbol)
    return _engines[-1].add(code, name)


class _Engine:
    """Functions that may share parts: parts of the same name are the same."""

    def __init__(self) -> None:
        import llvmlite.binding as llvm

        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self._environments: dict[str, tuple[list[str], Any]] = {}
        self._entries: set[str] = set()

    def has_room(self, code: MachineCode) -> bool:
        """Whether its names are not taken by something else, such as the same function before a change."""
        taken = self._environments
        return code.entry not in self._entries and all(
            taken[symbol][0] == dtypes for symbol, dtypes in code.environments.items() if symbol in taken
        )

    def add(self, code: MachineCode, name: str) -> Callable[..., Any]:
        import llvmlite.binding as llvm

        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code.code))
        self._engine.finalize_object()
        self._entries.add(code.entry)
        closures = _numba_module("_dynfunc")
        for symbol, dtypes in code.environments.items():
            if symbol not in self._environments:
                environment = closures.Environment({})
                environment.consts.extend(np.dtype(dtype) for dtype in dtypes)
                self._environments[symbol] = (dtypes, environment)
                address = self._engine.get_global_value_address(symbol)
                ctypes.c_void_p.from_address(address).value = id(environment)
        entry = self._engine.get_function_address(code.entry)
        own = self._environments[code.environment][1]
        module = SimpleNamespace(__name__=__name__)
        function: Callable[..., Any] = closures.make_function(module, name, "", entry, own, (self,))
        return function


_engines: list[_Engine] = []
"""They stay, with the code and what it refers to: arrays that a function made may live on to the end."""


@cache
def _provide(symbol: str) -> None:
    """Tell LLVM the address of something, by the name that numba gives it; C's library and Python's it finds itself."""
    import llvmlite.binding as llvm

    if symbol == "numba_unpickle":
        address = ctypes.cast(_UNPICKLE, ctypes.c_void_p).value
    elif symbol == "_Py_NoneStruct":
        address = id(None)
    elif symbol.startswith("PyExc_"):
        address = id(getattr(builtins, symbol.removeprefix("PyExc_")))
    elif symbol.startswith("NRT_"):
        address = _helpers("core.runtime._nrt_python").get(symbol.removeprefix("NRT_"))
    elif symbol.startswith("numba_"):
        name = symbol.removeprefix("numba_")
        address = _helpers("_helperlib").get(name) or _helpers("_dynfunc").get(name)
    else:  # C's functions of numbers are those that numba takes
        address = _helpers("_helperlib").get(symbol) or llvm.address_of_symbol(symbol)
    if not address:
        raise LinkError(f"not found: {symbol}")
    llvm.add_symbol(symbol, address)


_unpickled: dict[int, Any] = {}
"""By address: machine code stays where it is, and with it the bytes in it."""


def _unpickle(data: int, size: int, _: int) -> Any:
    """An object that machine code contains: a type, or an error to raise."""
    if data not in _unpickled:
        _unpickled[data] = pickle.loads(ctypes.string_at(data, size))  # noqa: S301  # part of the code that is running
    return _unpickled[data]


_UNPICKLE = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(_unpickle)


def _helpers(module: str) -> dict[str, int]:
    helpers: dict[str, int] = _numba_module(module).c_helpers
    return helpers


@cache
def _numba_module(name: str) -> ModuleType:
    """A module of numba that is written in C, without the package around it."""
    full = f"numba.{name}"
    if full in sys.modules:
        return sys.modules[full]
    root = _numba_folder()
    folder = str(root.joinpath(*name.split(".")[:-1])) if root else ""
    spec = importlib.machinery.PathFinder.find_spec(full, [folder])
    if spec is None or spec.loader is None:
        raise LinkError(f"not found: {full}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def _numba_folder() -> Path | None:
    spec = importlib.util.find_spec("numba")
    return Path(spec.origin).parent if spec is not None and spec.origin else None
