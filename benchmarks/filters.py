"""The steps of combining, compared with those of others on the same clouds, alternating in one run.

    python benchmarks/filters.py [--rounds 10] [--shared ../shared]

Clouds: every fifth frame of the KITTI sequence (112 000 points) and the oracle scene s30k_0 (three lidars, 86 000
points). Open3D's steps are similar: its outlier filter counts the point among its neighbours (11 for our 10), its plane
is unconstrained. The conversion to its float64 points is not counted. scipy's tree finds the same neighbours on one
thread, as lidcam does. Wall and CPU milliseconds are medians; Open3D chooses its number of threads. Where the machine
has PCL (Debian: pcl-tools), its `pcl_outlier_removal` runs on the same clouds and says itself how long it took, without
files; else what its outlier removal took on one thread of the machine that made the oracle stands there.
"""

import argparse
import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lidcam.bags.simulator.world.open3d_runtime import load_open3d
from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.combine import CombineConfig, GroundConfig, OutlierConfig
from lidcam.pipeline.filters.ground import find_ground
from lidcam.pipeline.filters.ground_kernels import COMPILED, parted
from lidcam.pipeline.filters.motion import coordinates, deskew
from lidcam.pipeline.filters.outliers import statistical_inliers
from lidcam.pipeline.filters.relief import find_relief
from lidcam.pipeline.stages.combine import Combine

SWEEP_NS = 100_000_000


def measure(step: Callable[[], object]) -> tuple[float, float]:
    """Wall and CPU milliseconds of one run of a step."""
    wall, cpu = time.perf_counter(), time.process_time()
    step()
    return (time.perf_counter() - wall) * 1e3, (time.process_time() - cpu) * 1e3


def load_clouds(shared: Path) -> dict[str, tuple[F32, F64]]:
    """Points and lidar origins by name of cloud, in the site frame."""
    clouds: dict[str, tuple[F32, F64]] = {}
    for frame in (0, 5, 10):
        path = shared / f"data/kitti_raw_sequence/velodyne_points/{frame:010d}.bin"
        clouds[f"KITTI {frame}"] = np.fromfile(path, "<f4").reshape(-1, 4)[:, :3].copy(), np.zeros((1, 3))
    scene = shared / "oracles/combiner/s30k_0"
    offsets = np.array(json.loads((scene / "scene.json").read_text(encoding="utf-8"))["offsets"])
    lidars = [np.fromfile(scene / f"{name}.bin", "<f4").reshape(-1, 4) for name in ("lidar11", "lidar12", "lidar2")]
    shifted = [lidar[:, :3] + offset.astype(np.float32) for lidar, offset in zip(lidars, offsets, strict=True)]
    clouds["s30k_0"] = np.concatenate(shifted), offsets
    return clouds


def our_steps(xyz: F32, origins: F64) -> dict[str, Callable[[], object]]:
    """Each step on its own input, and the whole stage."""
    outliers, ground = OutlierConfig(), GroundConfig()
    points = xyz[statistical_inliers(xyz, neighbors=outliers.neighbors, std_ratio=outliers.std_ratio)]
    every = np.ones(len(points), np.bool_)
    kept = coordinates(points, every).T
    found = find_ground(kept, origins, config=ground, passes=COMPILED)
    offsets_ns = np.linspace(0, SWEEP_NS - 1, len(xyz)).astype(np.int32)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = 0, 1, 2  # 10 m/s
    motion = PoseSamples("site", "odom", np.array([-1, 0, 1], np.int64) * SWEEP_NS, poses)
    cloud = PointCloud(
        0, "lidar", xyz, np.zeros(len(xyz), np.float32), np.zeros(len(xyz), np.uint16), offsets_ns, has_time=True
    )
    rig = Rig("site", (LidarSensor("lidar", "/lidar", Transform.identity("site", "lidar")),), (), ())
    combine = Combine(rig, CombineConfig())

    def remove_outliers() -> object:
        return xyz[statistical_inliers(xyz, neighbors=outliers.neighbors, std_ratio=outliers.std_ratio)]

    def remove_ground() -> object:
        plane = find_ground(kept, origins, config=ground, passes=COMPILED)
        if plane is None:
            return None
        rounded = np.append(plane.normal, plane.offset_m).astype(np.float32)
        rows, _, _ = parted(points, every, rounded, ground.distance_m, np.zeros(2), 1.0, np.zeros((0, 0)))
        return points[rows]

    return {
        "motion compensation": lambda: deskew(xyz, offsets_ns.astype(np.int64), 0, motion),
        "outliers": remove_outliers,
        "ground": remove_ground,
        "relief": lambda: None if found is None else find_relief(kept, origins, found, ground),
        "whole stage": lambda: combine(SensorBundle(0, 0, 0, {}, motion), {"lidar": cloud}),
    }


def open3d_steps(o3d: Any, xyz: F32) -> dict[str, Callable[[], object]]:
    """The same steps in Open3D."""
    outliers, ground = OutlierConfig(), GroundConfig()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz.astype(np.float64)))
    kept, _ = cloud.remove_statistical_outlier(outliers.neighbors + 1, outliers.std_ratio)

    def remove_ground() -> object:
        _, rows = kept.segment_plane(ground.distance_m, 3, ground.iterations)
        return kept.select_by_index(rows, invert=True)

    return {
        "outliers": lambda: cloud.remove_statistical_outlier(outliers.neighbors + 1, outliers.std_ratio),
        "ground": remove_ground,
    }


def scipy_steps(xyz: F32) -> dict[str, Callable[[], object]]:
    """The distances to neighbours by scipy's tree, without the statistics."""
    points, neighbors = xyz.astype(np.float64), OutlierConfig().neighbors
    return {"outliers": lambda: np.mean(cKDTree(points).query(points, k=neighbors + 1)[0], axis=1)}


PCD_HEAD = """VERSION .7
FIELDS x y z
SIZE 4 4 4
TYPE F F F
COUNT 1 1 1
WIDTH {count}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {count}
DATA binary
"""


def pcl_outliers_ms(xyz: F32) -> float | None:
    """Milliseconds of PCL's outlier removal, one thread; None where PCL is not installed."""
    program, outliers = shutil.which("pcl_outlier_removal"), OutlierConfig()
    if program is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        before, after = Path(folder, "in.pcd"), Path(folder, "out.pcd")
        before.write_bytes(PCD_HEAD.format(count=len(xyz)).encode() + np.ascontiguousarray(xyz, "<f4").tobytes())
        command = [program, str(before), str(after), "-method", "statistical"]
        command += ["-mean_k", str(outliers.neighbors), "-std_dev_mul", str(outliers.std_ratio)]
        run = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    # loading, filtering, saving: each ends with its time, in colour
    _, filtering, _ = re.findall(r"done, ([\d.e+]+) ms", re.sub(r"\x1b\[[\d;]*m", "", run.stdout))
    return float(filtering)


def main() -> None:
    """Measure and print all steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--shared", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    options = parser.parse_args()
    if not (options.shared / "data").is_dir():
        print(f"{options.shared}: no such folder; name the one that holds the clouds with --shared")
        return
    o3d = load_open3d()

    for name, (xyz, origins) in load_clouds(options.shared).items():
        libraries = {
            "lidcam": our_steps(xyz, origins),
            "scipy": scipy_steps(xyz),
            "Open3D": open3d_steps(o3d, xyz),
        }
        steps = [(step, library) for step in libraries["lidcam"] for library in libraries if step in libraries[library]]
        rounds = [[measure(libraries[library][step]) for step, library in steps] for _ in range(options.rounds)]
        print(f"{name}: {len(xyz)} points")
        pcl_ms = [ms for _ in range(options.rounds) if (ms := pcl_outliers_ms(xyz)) is not None]
        recorded = options.shared / "oracles/combiner" / name / "plane.json"
        if pcl_ms:
            print(f"  {'outliers':20s} PCL    {np.median(pcl_ms):7.1f} ms wall")
        elif recorded.is_file():
            pcl = json.loads(recorded.read_text(encoding="utf-8"))
            print(f"  {'outliers':20s} PCL    {pcl['sor_ms']:7.1f} ms wall, recorded")
        for (step, library), (wall_ms, cpu_ms) in zip(steps, np.median(rounds, axis=0), strict=True):
            print(f"  {step:20s} {library} {wall_ms:7.1f} ms wall {cpu_ms:7.1f} ms CPU")


if __name__ == "__main__":
    main()
