"""Detection by clusters, with compiled loops and with the array operations that they took the place of.

    python benchmarks/clusters.py [--rounds 10] [RECORDING ...]

Without a recording, the samples. Both ways find the boxes of the same frames in one run, alternating; milliseconds of
processor time a frame are the mean over the frames of the least of all rounds. What is told as the old way still reads
the points in compiled loops: it is the clustering and the search for L-shapes of `tests/support`, which judge the new
ones.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np

from lidcam.frames import RunInput
from lidcam.job import make_job
from lidcam.run import Run, opened
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes3D
from pipeline.stages.detect3d import Detect3D

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "bags" / "sandbox.bag", ROOT / "bags" / "crossing.mcap"
FRAMES = 10


def loaded(path: Path) -> tuple[Detect3D, list[CombinedCloud]]:
    """The stage with the settings of a recording, and the clouds of its first frames."""
    with opened(make_job(path, settings=("run.workers=1",))) as run:
        source: RunInput = run.source
        return Detect3D(source.rig, source.config), _clouds(run)


def _clouds(run: Run) -> list[CombinedCloud]:
    clouds = []
    for result in run.frames():
        clouds.append(result.combined)
        if len(clouds) == FRAMES:
            break
    return clouds


@contextmanager
def old_way() -> Iterator[None]:
    """Clusters and L-shapes by array operations."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    from cluster_judge import judged_cells, judged_clusters
    from lshape_judge import judged_quantiles, judged_rectangles

    fitting, detector = "pipeline.detectors.cluster.fitting", "pipeline.detectors.cluster.detector"
    with (
        patch(f"{fitting}.thin_points", judged_cells),
        patch(f"{fitting}.fit_rectangles", judged_rectangles),
        patch(f"{fitting}.quantiles_by_cluster", judged_quantiles),
        patch(f"{detector}.cluster_points", judged_clusters),
    ):
        yield


def timed(detect: Detect3D, cloud: CombinedCloud) -> tuple[float, Boxes3D]:
    """Milliseconds of processor time, and the boxes."""
    started = time.process_time()
    boxes = detect(cloud)
    return (time.process_time() - started) * 1e3, boxes


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path, default=SAMPLES)
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    for path in options.recordings:
        detect, clouds = loaded(path)
        ms = np.full((options.rounds, 2, len(clouds)), np.inf)
        differ = 0
        for taken in ms:
            for frame, cloud in enumerate(clouds):
                taken[0, frame], found = timed(detect, cloud)
                with old_way():
                    taken[1, frame], before = timed(detect, cloud)
                differ += not np.array_equal(found.centers, before.centers)
        new, old = ms.min(0).mean(1)
        points = np.mean([len(cloud.detection_cloud) for cloud in clouds])
        print(
            f"{path.name}: {points:.0f} points, {new:.1f} ms compiled, {old:.1f} ms by array operations, "
            f"{old / new:.1f} times; {differ} results differ"
        )


if __name__ == "__main__":
    main()
