"""nuScenes's own figures of an exported data set, beside those of `lidcam evaluate`.

    lidcam export out.mcap --format nuscenes --out set
    lidcam evaluate out.mcap --json-file figures.json --set evaluate.distances=nuscenes \
        --set evaluate.min_image_pixels=1000000
    python -m venv devkit && devkit/bin/pip install nuscenes-devkit==1.2.0
    devkit/bin/python nuscenes_kit.py set figures.json

The devkit asks for libraries that do not go together with those of lidcam, so it has an environment of its own. It
knows the scenes of nuScenes alone: it is given those of the set's `splits.json`. The second setting makes lidcam ignore
what has no lidar point, as the devkit does.
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
    """Print both, and the largest difference."""
    folder, figures = Path(sys.argv[1]), json.loads(Path(sys.argv[2]).read_text())
    fused, largest = figures["sources"]["fused"], 0.0
    for name, theirs in kit_figures(folder).items():
        ours = fused.get(name, {}).get("nuscenes", {})
        for figure, value in theirs.items():
            if ours.get(figure) is not None:
                largest = max(largest, abs(ours[figure] - value))
                print(f"{name:12} {figure:8} kit {value:8.4f}  lidcam {ours[figure]:8.4f}")
    print(f"largest difference {largest:.2g}")


if __name__ == "__main__":
    main()
