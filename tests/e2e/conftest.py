from functools import partial
from pathlib import Path

import pytest
from command import Lidcam, called

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def lidcam(tmp_path_factory: pytest.TempPathFactory) -> Lidcam:
    """Call `lidcam ...` in this process, from another folder, with arguments of any type that has a text form.

    `test_calling`, `test_usage` and `test_wheel` start the installed program.
    """
    return partial(called, tmp_path_factory.mktemp("elsewhere"))


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
