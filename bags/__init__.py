"""Sample recordings and the simulator that records them."""

from pathlib import Path

SAMPLE = Path(__file__).with_name("sandbox.bag")
"""The recording that comes with the wheel: 2 s of a model crossing."""
