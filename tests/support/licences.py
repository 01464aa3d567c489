"""The page of licences, from the metadata of the packages that are installed: `make docs/licences.md`."""

import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, distribution

from helpers import ROOT
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = ("foxglove", "video", "draco", "notebook", "http", "s3", "ray", "sim", "train", "test", "dev")
LINUX = {"sys_platform": "linux", "os_name": "posix", "platform_system": "Linux"}

TITLES = {"": "lidcam"} | {extra: f"Extra `{extra}`" for extra in EXTRAS}
TITLES |= {"test": "Tools of `make quick`", "dev": "Tools of the other tests"}

UNSAID = {"atheris": "Apache-2.0", "mcap": "MIT", "python-dateutil": "Apache-2.0 OR BSD-3-Clause"}
"""Licences that the files of a package state and its metadata do not."""

LONGEST = 60

INTRODUCTION = """# Licences

lidcam is under Apache-2.0; the laser angle tables in `readers/velodyne/models.py` are under BSD-3-Clause. This page
lists everything that is installed with lidcam on Linux, as stated by the packages. `make docs/licences.md` generates
it, and a test compares it with the installation. Versions and hashes are in `constraints.txt`.

Reports by `lidcam report` contain plotly.js (`writers/report/plotly-cartesian.min.js`) under MIT, with its notice.

These are not permissive:

- **av** (extra `video`) is under BSD-3-Clause, but its wheel contains FFmpeg with the encoders x264 and x265 under
  GPL-2.0-or-later. Anyone who redistributes an installation with this extra redistributes GPL code. lidcam decodes with
  av and writes films with x264.
- **opencv-python-headless** (installed with lidcam) contains FFmpeg under LGPL-2.1-or-later.
- **libusb-package** (extra `sim`) contains libusb under LGPL-2.1-or-later.
- **numpy**, **scipy** and **opencv-python-headless** contain libgfortran (GPL-3.0 with the runtime library exception)
  and libquadmath (LGPL-2.1-or-later); **small-gicp** contains libgomp (GPL-3.0 with the same exception).
- **certifi** (extra `sim`), **hypothesis** and **pathspec** (tests) are under MPL-2.0.
- PyPI's build of **torch** for Linux (extra `train`) brings NVIDIA's proprietary libraries; PyTorch's CPU build has
  none.
"""


def requirements_of(extra: str) -> list[str]:
    """What pyproject.toml asks for: of an extra, or with "" of lidcam itself."""
    project = PYPROJECT["project"]
    found: list[str] = project["optional-dependencies"][extra] if extra else project["dependencies"]
    return found


def closure(requirements: Iterable[str]) -> set[str]:
    """Names of all packages that are installed for these, on this Python under Linux."""
    seen: set[tuple[str, frozenset[str]]] = set()
    waiting = [(Requirement(one), "") for one in requirements]
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate(LINUX | {"extra": extra}):
            continue
        key = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if key in seen:
            continue
        seen.add(key)
        needed = distribution(requirement.name).requires or ()
        waiting += [(Requirement(one), extra) for one in needed for extra in ("", *requirement.extras)]
    return {name for name, _ in seen}


def licence_of(name: str) -> str:
    """What a package states: an SPDX expression, else a line, else classifiers; empty if nothing."""
    metadata = distribution(name).metadata
    if expressions := metadata.get_all("License-Expression"):
        return str(expressions[0])
    line = "".join(map(str, metadata.get_all("License") or ())).strip()
    if name in UNSAID:
        return UNSAID[name]
    if line and "\n" not in line and len(line) <= LONGEST:
        return line
    classifiers = [one for one in metadata.get_all("Classifier") or () if one.startswith("License :: ")]
    return ", ".join(one.rpartition(" :: ")[2] for one in classifiers)


def page() -> str:
    """The page."""
    return "\n".join([INTRODUCTION, *_tables()])


def _tables() -> Iterator[str]:
    known: set[str] = set()
    for extra in ("", *EXTRAS):
        names = closure(requirements_of(extra)) - known
        known |= names
        if extra == "train":
            names = {name for name in names if not name.startswith(("nvidia", "cuda", "triton"))}
        yield f"## {TITLES[extra]}\n\n| package | licence |\n| --- | --- |"
        yield from (f"| {name} | {re.sub(r'[|]', '/', licence_of(name))} |" for name in sorted(names))
        yield ""


if __name__ == "__main__":
    try:
        sys.stdout.write(page().rstrip("\n") + "\n")
    except PackageNotFoundError as err:
        sys.exit(f"{err.name}: not installed; make docs/licences.md installs all of it")
