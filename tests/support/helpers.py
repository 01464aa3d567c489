"""What several tests share."""

from pathlib import Path

import pytest


def shared(path: str) -> Path:
    """A file of the `shared` folder that lies beside the checkout; skips the test where it is absent."""
    for parent in Path(__file__).resolve().parents:
        candidate = parent / "shared" / path
        if candidate.exists():
            return candidate
    pytest.skip(f"needs shared/{path} beside the checkout")
