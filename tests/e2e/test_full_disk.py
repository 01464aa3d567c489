"""Outputs that cannot be written to their end; `tests/campaign/full_disks.py` tries many disks."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from builders import write_mcap
from small_drive import small_drive

PROGRAM = Path(sys.executable).with_name("lidcam-process")


@pytest.mark.parametrize("blocks", [20, 100])
def test_one_line_and_nothing_left(blocks: int, tmp_path: Path) -> None:
    """The size of a file is limited, in blocks of 512 bytes."""
    write_mcap(tmp_path / "drive.mcap", small_drive("cdr", frames=30))
    out = tmp_path / "out"
    out.mkdir()
    limited = ["sh", "-c", f'ulimit -f {blocks}; exec "$@"', "sh"]
    command = [PROGRAM, tmp_path / "drive.mcap", out / "out.mcap", "--rerun", out / "out.rrd"]
    env = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}  # it writes files, too
    done = subprocess.run(
        [*limited, *map(str, command)], capture_output=True, text=True, timeout=60, check=False, env=env
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"lidcam: error: {out}/out.")
    assert "cannot be written: File too large" in line
    assert list(out.iterdir()) == []
