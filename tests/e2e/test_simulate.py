"""`lidcam simulate`: a recording of a scenario, or one line that says why not."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command import Lidcam
from small_scenario import write_small_scenario

Simulate = Callable[..., Path]


@pytest.fixture
def simulate(lidcam: Lidcam, tmp_path: Path) -> Simulate:
    """Record the small scenario with changes; 1 s unless told."""

    def run(name: str = "out.bag", *options: object, duration: float = 1.0, **changes: Any) -> Path:
        scenario = write_small_scenario(tmp_path / "small.yaml", **changes)
        done = lidcam("simulate", scenario, tmp_path / name, "--duration", duration, *options)
        assert done.code == 0, done.err
        assert done.out == ""
        assert f"wrote {tmp_path / name}:" in done.err
        return tmp_path / name

    return run


def sums(path: Path) -> str:
    files = [path] if path.is_file() else sorted(path.iterdir())
    return "".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)


def test_same_seed_same_bytes_whatever_the_workers(simulate: Simulate) -> None:
    first = sums(simulate("out.mcap", "--workers", 1, duration=0.35))
    assert sums(simulate("out.mcap", "--workers", 3, duration=0.35)) == first
    assert sums(simulate("out.mcap", "--seed", 2, duration=0.35)) != first


def test_lidcam_opens_what_it_simulated(simulate: Simulate, lidcam: Lidcam) -> None:
    path = simulate("out.mcap", lidars__top__output="both", lidars__top__firing_stride=1)
    done = lidcam("inspect", path)
    assert done.code == 0, done.err
    for topic in ("/points", "/packets", "/image/compressed", "/boxes", "/ground_truth/objects"):
        assert topic in done.out


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("moon", "out.bag"), 1, "moon: expected a YAML file or one of crossing, sandbox, vehicle"),
        (("sandbox", "out.txt"), 1, "ends in .bag"),
        (("sandbox", "out.bag", "--format", "mcap"), 1, "out.bag: expected a name whose ending fits --format mcap"),
        (("sandbox", "out.bag", "--set", "lidars.velodyne9.topic=/a"), 1, "lidars.velodyne9"),
        (("sandbox", "nowhere/out.bag", "--duration", "0.1"), 1, "nowhere"),
        (("sandbox", "out.bag", "--duration", "0"), 2, "more than 0 seconds"),
        (("sandbox",), 2, "Missing argument"),
    ],
)
def test_what_cannot_be_simulated_is_said_in_one_line(
    lidcam: Lidcam, arguments: tuple[str, ...], code: int, message: str
) -> None:
    done = lidcam("simulate", *arguments)
    assert done.code == code
    assert message in (done.error_line if code == 1 else done.err)
    assert not Path("out.bag").exists()
