"""What the programs load only where they need it."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

COMMANDS = (
    ["--help"],
    ["config", "show", "sandbox"],
    ["inspect", "bags/sandbox.bag"],
    ["inspect", "bags/crossing.mcap"],
)

PROGRAM = f"""
import sys
from lidcam.__main__ import main
for arguments in {COMMANDS}:
    sys.argv = ["lidcam", *arguments]
    try:
        main()
    except SystemExit as end:
        assert not end.code, arguments
    assert "numba" not in sys.modules, arguments
"""


def test_only_what_processes_recordings_loads_compiled_functions() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
