"""Simulated recordings for measuring, and the results of lidcam: recorded once, processed and evaluated anew."""

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidcam.readers.results.result import open_result

ROOT = Path(__file__).resolve().parents[2]

SECONDS = {"sandbox": 20, "crossing": 10, "vehicle": 10}
"""Scenarios, and how long each is."""

RECORDED = ("--set", "cameras.*.jpeg_quality=40")
"""Images are looked at and not measured."""

MODES = ("none", "online", "offline")
"""Of tracks: frames by themselves, frame by frame, and with the future of each frame."""

WRITTEN = ("--set", "output.images=false", "--set", "output.clouds=false")
"""Boxes alone are evaluated."""


@dataclass(frozen=True)
class MeasuredRun:
    """A simulated recording and its result.

    Attributes:
        scenario: Its name.
        seconds: How long it is.
        recording: The simulated recording.
        result: The result of `lidcam process` with the settings that it chose itself.
        figures: The JSON of `lidcam evaluate`.
        when_measured: The same against where objects were at the time of their lidar points.
        by_mode: Results with each of `MODES` of tracks.
    """

    scenario: str
    seconds: int
    recording: Path
    result: Path
    figures: dict[str, Any]
    when_measured: dict[str, Any]
    by_mode: dict[str, Path]


def measured_run(scenario: str, folder: Path) -> MeasuredRun:
    """Simulate a scenario unless the folder holds its recording, process it, evaluate the result.

    Args:
        scenario: A key of `SECONDS`.
        folder: Where recordings are kept from one time to the next.
    """
    folder.mkdir(parents=True, exist_ok=True)
    recording = folder / f"{scenario}-{_origin(scenario)}.mcap"
    if not recording.exists():
        for old in folder.glob(f"{scenario}-*.mcap"):
            old.unlink()
        _lidcam("simulate", scenario, recording, "--duration", SECONDS[scenario], *RECORDED)
    result = folder / f"{scenario}.mcap"
    files = {name: folder / f"{scenario}.{name}.json" for name in ("figures", "when_measured")}
    _lidcam("process", recording, result, "--overwrite", *WRITTEN)
    _lidcam("evaluate", result, "--json-file", files["figures"])
    _lidcam("evaluate", result, "--json-file", files["when_measured"], "--set", "evaluate.truth_time=points")
    trees = {name: json.loads(path.read_bytes()) for name, path in files.items()}
    return MeasuredRun(scenario, SECONDS[scenario], recording, result, **trees, by_mode=_by_mode(recording, result))


def _by_mode(recording: Path, result: Path) -> dict[str, Path]:
    """Results by their mode of tracks; that of `result` is its own."""
    with open_result(result) as opened:
        own = opened.config.track.mode
    found = {mode: result if mode == own else result.with_suffix(f".{mode}.mcap") for mode in MODES}
    for mode, path in found.items():
        if mode != own:
            _lidcam("process", recording, path, "--overwrite", *WRITTEN, "--set", f"track.mode={mode}")
    return found


def _origin(scenario: str) -> str:
    """A checksum of all that a simulated recording is made from: another one is simulated when it changes."""
    digest = hashlib.sha256(repr((scenario, SECONDS[scenario], RECORDED)).encode())
    for path in _sources(scenario):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def _sources(scenario: str) -> Iterator[Path]:
    yield from sorted((ROOT / "bags" / "simulator").rglob("*.py"))
    yield ROOT / "config" / "scenarios" / f"{scenario}.yaml"


def _lidcam(*arguments: object) -> None:
    """Run the installed program; what it prints is shown only if it fails."""
    command = [sys.executable, "-m", "lidcam", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{' '.join(command)}: exit {done.returncode}\n{done.stdout}\n{done.stderr}")
