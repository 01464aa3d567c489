"""The installed command, run from another folder."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from command import Lidcam, Run
from fork_server import ForkServer

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def lidcam(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lidcam]:
    """Call `lidcam ...` as a user would, with arguments of any type that has a text form."""
    with ForkServer(tmp_path_factory.mktemp("elsewhere")) as server:

        def run(*arguments: object) -> Run:
            return server.run([*map(str, arguments)])

        yield run


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
