"""What each command imports of the large libraries: nothing that it does not use."""

import subprocess
import sys
from pathlib import Path

import pytest

SANDBOX = Path(__file__).resolve().parents[2] / "bags/sandbox.bag"
SEEN = (
    "cv2",
    "google.protobuf",
    "llvmlite",
    "numba",
    "numpy",
    "onnxruntime",
    "open3d",
    "pandas",
    "PIL",
    "rerun",
    "rosbags",
    "scipy",
)
SEEN_PARTS = (
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.sparse",
    "scipy.spatial",
    "lidcam.evaluation.requirement",
    "lidcam.inspection",
    "pipeline.stages.combine",
    "readers.files.mcap.file",
    "readers.files.pcap.file",
    "readers.files.rosbag1.file",
    "readers.files.sqlite.file",
    "readers.rig.draft",
    "readers.rig.importers.kitti",
    "rich.progress",
    "rosbags.convert",
)
"""Formats that a recording is not of, what is asked for by options, and what only another command does."""

PROGRAM = f"""
import sys
sys.argv[0] = "lidcam"
from lidcam.__main__ import main
try:
    main()
finally:
    print(*sorted({{*{SEEN + SEEN_PARTS}}} & {{*sys.modules}}), file=sys.stderr)
"""


def imported(*arguments: str) -> set[str]:
    """Of `SEEN` and `SEEN_PARTS`, what a command imports."""
    run = subprocess.run([sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return {*run.stderr.splitlines()[-1].split()}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str]]:
    """A result, and what was imported to make it, where what has to be compiled is kept."""
    path = tmp_path_factory.mktemp("imports") / "out.mcap"
    run = ("process", str(SANDBOX), str(path), "--start", "0.5", "--duration", "0.1", "--workers", "1", "--overwrite")
    imports = imported(*run)
    return path, imported(*run) if "numba" in imports else imports


@pytest.mark.parametrize("arguments", [("--help",), ("process", "--help"), ("--version",)])
def test_help_imports_no_library_of_numbers(arguments: tuple[str, ...]) -> None:
    assert imported(*arguments) == set()


def test_inspect_imports_what_reads() -> None:
    reads = {"readers.files.rosbag1.file", "readers.rig.draft"}
    libraries = {"PIL", "numpy", "rosbags"}
    assert imported("inspect", str(SANDBOX)) == {*libraries, "lidcam.inspection", *reads}


def test_process_imports_no_viewer_no_network_and_no_compiler(result: tuple[Path, set[str]]) -> None:
    libraries = {"PIL", "llvmlite", "numpy", "rosbags"}
    assert result[1] == {*libraries, "pipeline.stages.combine", "readers.files.rosbag1.file"}


def test_evaluate_imports_no_stages(result: tuple[Path, set[str]]) -> None:
    assert not imported("evaluate", str(result[0])) & {
        "numba",
        "rerun",
        "onnxruntime",
        "pandas",
        "pipeline.stages.combine",
    }
