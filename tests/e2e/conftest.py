"""The installed command, run from another folder."""

import subprocess
import sys
from pathlib import Path

import pytest
from command import Lidcam, Run

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def lidcam(tmp_path_factory: pytest.TempPathFactory) -> Lidcam:
    """Call `lidcam ...` as a user would, with arguments of any type that has a text form."""
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    program = Path(sys.executable).with_name("lidcam")

    def run(*arguments: object) -> Run:
        command = [str(program), *map(str, arguments)]
        done = subprocess.run(command, cwd=elsewhere, capture_output=True, text=True, timeout=300, check=False)
        return Run(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def sandbox() -> Path:
    """The sample recording."""
    return ROOT / "bags" / "sandbox.bag"


@pytest.fixture(scope="session")
def crossing() -> Path:
    """Another one, of MCAP."""
    return ROOT / "bags" / "crossing.mcap"


@pytest.fixture(scope="session")
def sandbox_config() -> Path:
    """Its settings."""
    return ROOT / "config" / "sandbox.yaml"
