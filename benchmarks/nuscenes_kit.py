"""nuScenes's own figures of an exported data set.

    lidcam export out.mcap --format nuscenes --out set
    python -m venv devkit && devkit/bin/pip install nuscenes-devkit==1.2.0
    devkit/bin/python nuscenes_kit.py set

The devkit asks for libraries that do not go together with those of lidcam, so it has an environment of its own. It
knows the scenes of nuScenes alone: it is given those of the set's `splits.json`.
"""

import json
import sys
import tempfile
from pathlib import Path

import nuscenes.eval.common.loaders as loaders
from nuscenes import NuScenes
from nuscenes.eval.detection.config import config_factory
from nuscenes.eval.detection.evaluate import DetectionEval

VERSION = "v1.0-lidcam"
ERRORS = {"trans_err": "ate", "scale_err": "ase", "orient_err": "aoe"}


def kit_figures(folder: Path) -> dict[str, dict[str, float]]:
    """The devkit's figures by class."""
    scenes = json.loads((folder / VERSION / "splits.json").read_text())
    tables = NuScenes(VERSION, dataroot=str(folder), verbose=False)
    tables.version = "v1.0-trainval"  # whose split `val` is asked for
    loaders.create_splits_scenes = lambda: {"val": scenes["lidcam"]}
    with tempfile.TemporaryDirectory() as out:
        config = config_factory("detection_cvpr_2019")
        judge = DetectionEval(tables, config, str(folder / "results.json"), "val", out, verbose=False)
        metrics, _ = judge.evaluate()
    found: dict[str, dict[str, float]] = {}
    for name, by_distance in metrics._label_aps.items():
        found[name] = {_name(limit): value for limit, value in by_distance.items()}
        found[name] |= {ours: metrics.get_label_tp(name, theirs) for theirs, ours in ERRORS.items()}
    return found


def _name(limit_m: float) -> str:
    return f"ap_{limit_m:g}".replace(".", "p")


def main() -> None:
    """Print them."""
    for name, figures in kit_figures(Path(sys.argv[1])).items():
        print(name, *(f"{figure} {value:.4f}" for figure, value in figures.items()))


if __name__ == "__main__":
    main()
