"""Builds lidcam's native module: `pipeline/native/*.cpp` becomes `lidcam.pipeline.native.kernels`.

The compiler is that of the environment (`CXX`) or of the machine; where there is none, it comes as the wheel `ziglang`.
"""

import os
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MODULE = "kernels"
HAS_COMPILER = "CXX" in os.environ or any(map(shutil.which, ("c++", "g++", "clang++", "cl")))


class NativeModule(BuildHookInterface[Any]):
    """Compiles in the tree for an editable install, and into the wheel otherwise."""

    def dependencies(self) -> list[str]:
        """What the build needs beside hatchling."""
        return ["nanobind>=2.4", "setuptools>=75", *([] if HAS_COMPILER else ["ziglang>=0.13"])]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and name the result to hatchling."""
        folder, self._scratch = Path(self.root) / "pipeline/native", TemporaryDirectory()
        build_data["pure_python"], build_data["infer_tag"] = False, True
        made = compiled(folder, Path(self._scratch.name))
        if version == "editable":  # at once: other processes may be importing it
            shutil.copy(made, folder / f"{made.name}.new")
            (folder / f"{made.name}.new").replace(folder / made.name)
        else:
            build_data["force_include"][str(made)] = f"lidcam/pipeline/native/{made.name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:  # noqa: ARG002  # hatchling's
        """Remove what was needed while the wheel was made."""
        self._scratch.cleanup()


def compiled(folder: Path, scratch: Path) -> Path:
    """The module built of the C++ files in a folder."""
    import nanobind
    from setuptools import Distribution, Extension

    if not HAS_COMPILER:
        clang = f"{sys.executable} -m ziglang c++ -mcpu=baseline"
        os.environ |= {"CC": clang, "CXX": clang, "LDSHARED": f"{clang} -shared", "LDCXXSHARED": f"{clang} -shared"}
    nanobind_at = Path(nanobind.include_dir())
    is_msvc = sys.platform == "win32"
    flags = ["/std:c++17", "/O2", "/fp:precise"] if is_msvc else _FLAGS
    extension = Extension(
        MODULE,
        [str(folder / "module.cpp"), str(Path(nanobind.source_dir()) / "nb_combined.cpp")],
        include_dirs=[str(nanobind_at), str(nanobind_at.parent / "ext/robin_map/include")],
        define_macros=[("NDEBUG", None), ("NB_COMPACT_ASSERTIONS", None)],
        extra_compile_args=flags,
        extra_link_args=["-s"] if sys.platform == "linux" else [],
        language="c++",
    )
    build = Distribution({"name": MODULE, "ext_modules": [extension]}).get_command_obj("build_ext")
    build.build_lib, build.build_temp = str(scratch / "lib"), str(scratch / "temp")
    build.ensure_finalized()
    build.run()
    return Path(build.get_outputs()[0])


_FLAGS = [
    "-std=c++17",
    "-O3",
    "-g0",
    "-fvisibility=hidden",
    "-fno-strict-aliasing",  # nanobind's own
    "-fno-math-errno",
    "-fno-trapping-math",  # nobody asks for exceptions: loops with a choice become vectors, with the same sums
    "-ffp-contract=off",  # the same sums on every machine
    "-Wno-psabi",
]
