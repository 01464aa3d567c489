"""What several tests share."""

from pathlib import Path

import pytest

CLUSTERS = "detect3d.method=cluster"
"""The setting of runs that do not test detection: the network of the default takes longer than all the rest."""


def shared(path: str) -> Path:
    """A file of the `shared` folder that lies beside the checkout; skips the test where it is absent."""
    for parent in Path(__file__).resolve().parents:
        candidate = parent / "shared" / path
        if candidate.exists():
            return candidate
    pytest.skip(f"needs shared/{path} beside the checkout")
