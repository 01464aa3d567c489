"""What is installed is listed with its hashes and licences, and nothing that is read is executed."""

import ast
import re

import pytest
from helpers import ROOT
from import_graph import sources, tree_of
from licences import EXTRAS, PYPROJECT, closure, licence_of, page, requirements_of
from packaging.utils import canonicalize_name

PAGE = ROOT / "docs" / "licences.md"

PYTORCH = re.compile(r"torch$|nvidia-|cuda-|triton$")
"""In no lock: see Makefile."""


def locked(name: str) -> dict[str, tuple[str, list[str]]]:
    """Version and hashes by package."""
    text = (ROOT / name).read_text(encoding="utf-8").replace("\\\n", " ")
    entries = [line.split() for line in text.splitlines() if line and not line.lstrip().startswith("#")]
    found: dict[str, tuple[str, list[str]]] = {}
    for words in entries:
        package, _, version = words[0].partition("==")
        hashes = [word.removeprefix("--hash=sha256:") for word in words if word.startswith("--hash=")]
        assert version, words[0]
        found[canonicalize_name(package)] = version, hashes
    return found


@pytest.mark.parametrize(
    ("name", "packages"), [("constraints.txt", 100), ("constraints-run.txt", 30), ("constraints-uv.txt", 1)]
)
def test_every_package_of_a_lock_has_hashes(name: str, packages: int) -> None:
    lock = locked(name)
    assert len(lock) >= packages
    assert [package for package, (_, hashes) in lock.items() if not hashes] == []
    assert all(re.fullmatch("[0-9a-f]{64}", one) for _, hashes in lock.values() for one in hashes)


def test_the_locks_hold_all_that_is_installed_and_agree() -> None:
    run, everything = locked("constraints-run.txt"), locked("constraints.txt")
    assert closure(requirements_of("")) <= run.keys()
    wanted = {name for extra in ("", *EXTRAS) for name in closure(requirements_of(extra))}
    assert {name for name in wanted if not PYTORCH.match(name)} <= everything.keys()
    assert {name: entry for name, entry in everything.items() if name in run} == run


def test_the_back_end_of_the_build_is_pinned() -> None:
    (required,) = PYPROJECT["build-system"]["requires"]
    assert required == f"hatchling=={locked('constraints-run.txt')['hatchling'][0]}"
    assert PYPROJECT["project"]["optional-dependencies"]["train"] == ["torch==2.13.0", "onnx>=1.17"]


def test_make_installs_by_hash() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^LOCKED = .* install .*--require-hashes --no-deps --requirement$", makefile, re.MULTILINE)
    uv, itself, pytorch = re.findall(r"^\t\$\(PIP\) install (.*)$", makefile, re.MULTILINE)
    assert uv == "--require-hashes --no-deps --requirement constraints-uv.txt"
    assert itself == "--no-build-isolation --no-deps --editable ."
    assert re.fullmatch(r"--no-compile 'lidcam\[[\w,]+\]'", pytorch)  # lidcam is installed: what it lacks is PyTorch


def licences_of_page() -> dict[str, str]:
    return dict(re.findall(r"^\| ([a-z0-9-]+) \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE))


@pytest.mark.parametrize("extra", ["", *EXTRAS])
def test_the_page_of_licences_lists_what_is_installed(extra: str) -> None:
    listed = licences_of_page()
    found = {name: licence_of(name).replace("|", "/") for name in closure(requirements_of(extra))}
    found = {name: licence for name, licence in found.items() if not PYTORCH.match(name) or name == "torch"}
    assert found
    assert {name: listed.get(name) for name in found} == found
    assert all(found.values())


def test_the_page_of_licences_says_what_is_not_permissive() -> None:
    listed = licences_of_page()
    text = PAGE.read_text(encoding="utf-8").partition("## lidcam")[0]
    assert text == page().partition("## lidcam")[0]
    copyleft = {name for name, licence in listed.items() if re.search(r"GPL|Mozilla|MPL", licence)}
    assert copyleft >= {"certifi", "hypothesis"}
    assert {name for name in copyleft if f"**{name}**" not in text} == set()
    for words in ("x264 and x265", "GPL-2.0-or-later", "**av** (extra `video`)", "**opencv-python-headless**"):
        assert words in text


EXECUTING = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "code", "codeop"}


def test_nothing_that_is_read_is_executed() -> None:
    """Ruff finds calls; here are the imports of what would execute, and pickles inside of other files."""
    chosen = set(PYPROJECT["tool"]["ruff"]["lint"]["select"])
    assert chosen >= {"S102", "S301", "S302", "S307", "S506", "S602", "S604", "S605"}
    found = set()
    for path in sources(ROOT):
        text = path.read_text(encoding="utf-8")
        assert "allow_pickle=True" not in text, path
        assert all("weights_only=True" in call for call in re.findall(r"torch\.load\(.*", text)), path
        for node in ast.walk(tree_of(path)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found |= {(path.name, name) for name in names if name.split(".")[0] in EXECUTING}
    # What is unpickled comes from processes that lidcam has started, over sockets and files that no other has; given.py
    # tries with a function of the caller's whether it can be sent to them.
    assert found == {(name, "pickle") for name in ("transfer.py", "local.py", "ray.py", "worker.py", "given.py")}


def test_the_image_is_of_checked_wheels_and_has_no_root() -> None:
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    installs = [line for line in lines if "pip install" in line]
    assert all("--no-deps" in line for line in installs)
    assert [re.findall(r"--requirement (\S+)", line) for line in installs if "--require-hashes --no-deps" in line] == [
        ["constraints-run.txt", "constraints-compiler.txt"]
    ]
    assert next(line for line in installs if "--require-hashes" not in line).endswith(
        "--no-build-isolation --no-deps ."
    )
    stage = lines[max(row for row, line in enumerate(lines) if line.startswith("FROM ")) :]
    assert stage.index("USER lidcam") < stage.index("RUN lidcam demo /tmp/demo && rm -r /tmp/demo")
    assert [line for line in stage if line.startswith("USER")] == ["USER lidcam"]
