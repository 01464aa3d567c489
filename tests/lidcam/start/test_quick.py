"""What makes a start quick."""

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys
from lidcam.start.quick import start_quickly
start_quickly()
sys.path.insert(0, sys.argv[1])
from pipeline.core.settings.config import Config
Config()
"""
PLUGIN = """
class Plugin:
    def __getattr__(self, name):
        raise SystemExit("a plugin was asked")
plugin = Plugin()
"""


def test_settings_ask_no_plugins_of_other_packages(tmp_path: Path) -> None:
    metadata = tmp_path / "noisy-1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: noisy\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text("[pydantic]\nnoisy = noisy:plugin\n")
    (tmp_path / "noisy.py").write_text(PLUGIN)
    run = subprocess.run([sys.executable, "-c", PROGRAM, str(tmp_path)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
