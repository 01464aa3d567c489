"""What commands import of the large libraries: nothing that they do not use."""

import subprocess
import sys
from pathlib import Path

from helpers import SANDBOX

SEEN = ("cv2", "numpy", "onnxruntime", "open3d", "pandas", "rerun", "rich", "rosbags", "scipy")
PROGRAM = f"""
import sys
sys.argv[0] = "lidcam"
from lidcam.__main__ import main
try:
    main()
finally:
    print(*sorted({{*{SEEN}}} & {{*sys.modules}}), file=sys.stderr)
"""


def imported(*arguments: str) -> set[str]:
    """Of `SEEN`, what a command imports."""
    run = subprocess.run([sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return {*run.stderr.splitlines()[-1].split()}


def test_help_imports_no_large_library() -> None:
    assert imported("process", "--help") == set()


def test_the_package_imports_nothing_before_it_is_used() -> None:
    code = "import sys, lidcam; print(*sorted({'numpy', 'cv2', 'rosbags', 'pydantic'} & {*sys.modules}))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"


def test_process_imports_no_viewer_and_no_network(tmp_path: Path) -> None:
    """No network where none runs."""
    run = ["process", str(SANDBOX), str(tmp_path / "out.mcap"), "--duration", "0.1", "--workers", "1"]
    run += ["--set", "detect3d.method=cluster"]
    assert not imported(*run) & {"onnxruntime", "open3d", "pandas", "rerun", "scipy"}
