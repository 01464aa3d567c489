"""Simulated recordings for measuring, and the results of lidcam: recorded once, processed and evaluated anew."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pages import ROOT, run_lidcam

from lidcam.readers.results.result import open_result

SECONDS = {"sandbox": 20, "crossing": 10, "vehicle": 10}  # by scenario
RECORDED = ("--set", "cameras.*.jpeg_quality=40")
WRITTEN = ("--set", "output.images=false", "--set", "output.clouds=false")  # boxes alone are evaluated

MODES = ("none", "online", "offline")
"""Modes of tracks: frames by themselves, frame by frame, and with the future of each frame."""


@dataclass(frozen=True)
class MeasuredRun:
    """A simulated recording and its result."""

    scenario: str  # Its name
    seconds: int  # How long it is
    recording: Path  # The simulated recording
    result: Path  # The result of `lidcam process` with the settings that it chose itself
    figures: dict[str, Any]  # The JSON of `lidcam evaluate`
    when_measured: dict[str, Any]  # The same against where objects were at the time of their lidar points
    by_mode: dict[str, Path]  # Results with each of `MODES` of tracks


def measured_run(scenario: str, folder: Path) -> MeasuredRun:
    """Simulate a scenario unless the folder holds its recording, process it, evaluate the result."""
    folder.mkdir(parents=True, exist_ok=True)
    recording = folder / f"{scenario}-{_origin(scenario)}.mcap"
    if not recording.exists():
        for old in folder.glob(f"{scenario}-*.mcap"):
            old.unlink()
        run_lidcam("simulate", scenario, recording, "--duration", SECONDS[scenario], *RECORDED)
    result = folder / f"{scenario}.mcap"
    files = {name: folder / f"{scenario}.{name}.json" for name in ("figures", "when_measured")}
    run_lidcam("process", recording, result, "--overwrite", *WRITTEN)
    run_lidcam("evaluate", result, "--json-file", files["figures"])
    run_lidcam("evaluate", result, "--json-file", files["when_measured"], "--set", "evaluate.truth_time=points")
    trees = {name: json.loads(path.read_bytes()) for name, path in files.items()}
    return MeasuredRun(scenario, SECONDS[scenario], recording, result, **trees, by_mode=_by_mode(recording, result))


def _by_mode(recording: Path, result: Path) -> dict[str, Path]:
    """Results by their mode of tracks; that of `result` is its own."""
    with open_result(result) as opened:
        own = opened.config.track.mode
    found = {mode: result if mode == own else result.with_suffix(f".{mode}.mcap") for mode in MODES}
    for mode, path in found.items():
        if mode != own:
            run_lidcam("process", recording, path, "--overwrite", *WRITTEN, "--set", f"track.mode={mode}")
    return found


def _origin(scenario: str) -> str:
    """A checksum of all that a simulated recording is made from: another one is simulated when it changes."""
    digest = hashlib.sha256(repr((scenario, SECONDS[scenario], RECORDED)).encode())
    sources = sorted((ROOT / "bags" / "simulator").rglob("*.py"))
    for path in [*sources, ROOT / "config" / "scenarios" / f"{scenario}.yaml"]:
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]
