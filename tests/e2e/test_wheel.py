"""The wheel, in an environment of its own, from another folder: what a user gets.

`make demo` installs what the lock names by its hashes: that is taken over from there.
"""

import os
import re
import subprocess
import sys
import sysconfig
import venv
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from zipfile import ZipFile

import pytest
import trove_classifiers
from builders import write_mcap
from helpers import ROOT
from packaging.metadata import Metadata
from results import fused_objects
from small_drive import small_drive


def run(*command: object, cwd: Path) -> str:
    clean = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    done = subprocess.run([str(c) for c in command], cwd=cwd, env=clean, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


def check_metadata(wheel: Path) -> None:
    """What an index shows: a licence with its text, who, what and where, and a page whose links work there."""
    with ZipFile(wheel) as files:
        names = set(files.namelist())
        (name,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        metadata = Metadata.from_email(files.read(name), validate=True)
    assert metadata.license_expression == "Apache-2.0 AND BSD-3-Clause AND MIT"
    assert {f"{name.split('/')[0]}/licenses/{text}" for text in metadata.license_files or ()} < names
    assert metadata.author == "lidcam developers"
    assert metadata.keywords
    assert {"Homepage", "Documentation", "Issues"} <= set(metadata.project_urls or ())
    assert set(metadata.classifiers or ()) <= trove_classifiers.classifiers
    assert {"Typing :: Typed", *(f"Programming Language :: Python :: 3.{n}" for n in (11, 12, 13))} <= set(
        metadata.classifiers or ()
    )
    assert {"sim", "train", "foxglove", "video", "http", "s3"} <= set(metadata.provides_extra or ())
    assert metadata.description_content_type == "text/markdown"
    links = re.findall(r"\]\(([^)]+)\)", metadata.description or "")
    assert links
    assert [link for link in links if not link.startswith("https://")] == []
    pillars = "lidcam/pipeline/detectors/pillars"
    assert {f"{pillars}/{name}.{kind}" for name in ("traffic", "sandbox") for kind in ("onnx", "md")} < names
    assert "lidcam/py.typed" in names
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"lidcam"}


def write_foreign_wheel(folder: Path) -> Path:
    """A wheel of another project, which has a package `pipeline`."""
    path, info = folder / "foreign-1.0-py3-none-any.whl", "foreign-1.0.dist-info"
    wheel = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    with ZipFile(path, "w") as file:
        file.writestr("pipeline/__init__.py", "FOREIGN = True\n")
        file.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: foreign\nVersion: 1.0\n")
        file.writestr(f"{info}/WHEEL", wheel)
        file.writestr(f"{info}/RECORD", "".join(f"{name},,\n" for name in (*file.namelist(), f"{info}/RECORD")))
    return path


def link_what_the_lock_names(packages: Path, programs: Path) -> None:
    """Links to it, and to nothing else that is installed here."""
    for name in re.findall(r"^([\w.-]+)==", (ROOT / "constraints-run.txt").read_text(encoding="utf-8"), re.MULTILINE):
        with suppress(PackageNotFoundError):  # of other systems
            package = distribution(name)
            for file in package.files or ():
                is_program = file.parts[0] == ".."
                link = programs / file.name if is_program else packages / file.parts[0]
                if not link.exists() and file.parts[0] != "__pycache__":
                    link.symlink_to(str(package.locate_file(file if is_program else file.parts[0])))


@pytest.mark.slow
def test_wheel_runs_elsewhere(tmp_path: Path) -> None:
    # sdist first, wheel from it: a file that the sdist lacks is missing from the wheel, too
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path / "dist", cwd=ROOT)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    assert wheel.stat().st_size < 12_000_000
    check_metadata(wheel)
    venv.create(tmp_path / "env")
    python, elsewhere = tmp_path / "env" / "bin" / "python", tmp_path / "elsewhere"
    elsewhere.mkdir()
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(tmp_path / "env")}))
    link_what_the_lock_names(packages, python.parent)
    pip = (sys.executable, "-m", "pip", "--python", python, "--quiet", "--disable-pip-version-check")
    foreign, is_foreign = write_foreign_wheel(tmp_path), "import pipeline; assert pipeline.FOREIGN"
    run(*pip, "install", "--no-index", foreign, cwd=elsewhere)
    run(*pip, "install", "--no-index", wheel, cwd=elsewhere)  # the lock is complete
    run(python, "-c", is_foreign, cwd=elsewhere)
    scenarios = (
        "from lidcam.bags.simulator.scenario.scenario import load_scenario, scenario_names; "
        "print([load_scenario(name).world for name in scenario_names()])"
    )
    assert run(python, "-c", scenarios, cwd=elsewhere).strip() == str(["crossing", "sandbox", "street"])
    simulate = [str(python.with_name("lidcam")), "simulate", "sandbox", "out.bag"]
    failed = subprocess.run(simulate, cwd=elsewhere, capture_output=True, text=True, check=False)
    assert failed.returncode == 1
    assert "which is not installed: pip install 'lidcam[sim]'" in failed.stderr
    code = "import lidcam; print(lidcam.inspect(lidcam.sample()).settings)"
    assert "sandbox" in run(python, "-c", code, cwd=elsewhere)
    assert "distance_m: 0.06" in run(python.with_name("lidcam"), "config", "show", "sandbox", cwd=elsewhere)
    write_mcap(elsewhere / "in.mcap", small_drive("cdr", frames=4))
    arguments = ("in.mcap", "out.mcap", "--rerun", "out.rrd", "--workers", "1")
    assert "4 frames in " in run(python.with_name("lidcam-process"), *arguments, cwd=elsewhere)
    assert len(fused_objects(elsewhere / "out.mcap")) == 4
    assert (elsewhere / "out.rrd").stat().st_size > 10_000
    for name in ("pipeline.py", "readers.py", "writers.py"):  # of a user, in the working folder
        (elsewhere / name).write_text("raise SystemExit(1)", encoding="utf-8")
    run(*pip, "uninstall", "--yes", "foreign", cwd=elsewhere)
    assert "sandbox" in run(python, "-c", code, cwd=elsewhere)
    for name in ("pipeline.py", "readers.py", "writers.py"):
        (elsewhere / name).unlink()
    run(*pip, "install", "--no-index", foreign, cwd=elsewhere)
    run(*pip, "uninstall", "--yes", "lidcam", cwd=elsewhere)
    run(python, "-c", is_foreign, cwd=elsewhere)
