"""The cost of a simulated second by sensor, beside that of casting its rays alone, alternating in one run.

    python benchmarks/simulator.py [SCENARIO ...] [--rounds 20] [--seconds 10]

Lidars: a whole sweep (movers, edges, glass, noise), and the same beams cast once at the static world. Cameras: the
first image (a fixed camera renders the static world for it) and the later ones, without JPEG. Milliseconds are
processor time over all cores: medians for lidars, means for later images, as their content varies. The whole:
wall-clock time of `lidcam simulate` on all cores, start-up included.
"""

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from bags.simulator.recorder.stage import Stage
from bags.simulator.scenario.load import load_scenario
from bags.simulator.scenario.scenario import Scenario
from bags.simulator.sensors.beams import pattern_of
from bags.simulator.sensors.camera import Camera
from bags.simulator.sensors.lidar import Lidar

WARM_UP_S = 2.0


def warm_stage(scenario: Scenario, rounds: int) -> Stage:
    """A stage that has advanced for as long as the slowest sensor needs."""
    stage = Stage(scenario)
    slowest_hz = min((sensor.rate_hz for sensor in scenario.sensors.values()), default=10.0)
    stage.traffic.advance(round((WARM_UP_S + (rounds + 2) / slowest_hz) * 1e9))
    return stage


def measure_cameras(label: str, scenario: Scenario, rounds: int) -> None:
    """Print the cost of each camera of a scenario, some seconds after its start."""
    stage, total_ms = warm_stage(scenario, rounds), 0.0
    for name, settings in scenario.cameras.items():
        camera = Camera(name, settings, stage.sensor_path(settings), stage.scene, scenario.sun, scenario.seed)
        first = round(WARM_UP_S * settings.rate_hz)
        times_ns = [round(number * 1e9 / settings.rate_hz) for number in range(first, first + rounds + 1)]
        first_ms, *later_ms = (processor_ms(partial(camera.image, *numbered)) for numbered in enumerate(times_ns))
        image_ms = statistics.mean(later_ms)
        moving = int(camera.image(0, times_ns[len(times_ns) // 2]).seen_px.sum())
        total_ms += image_ms * settings.rate_hz
        print(
            f"{label:10s} {name:12s} first image {first_ms:6.0f} ms  later ones {image_ms:6.1f} ms  "
            f"{moving} pixels of movers"
        )
    print(f"{label:10s} cameras: {total_ms:.0f} ms of processor time per simulated second")


def measure_lidars(label: str, scenario: Scenario, rounds: int) -> float:
    """Print the cost of each lidar of a scenario, some seconds after its start; returns all beams per second."""
    stage, total_ms, beams = warm_stage(scenario, rounds), 0.0, 0.0
    for name, settings in scenario.lidars.items():
        lidar = Lidar(name, settings, stage.sensor_path(settings), stage.scene, scenario.seed)
        first = round(WARM_UP_S * settings.rate_hz)
        rays = lidar.rays(pattern_of(settings).beams(first))
        sweeps, plain = [], []
        for number in range(rounds):
            plain.append(processor_ms(partial(stage.scene.cast_static, rays)))
            sweeps.append(processor_ms(partial(lidar.sweep, first + number)))
        sweep_ms, plain_ms = statistics.median(sweeps), statistics.median(plain)
        total_ms += sweep_ms * settings.rate_hz
        beams += len(rays) * settings.rate_hz
        print(
            f"{label:10s} {name:12s} {len(rays):7d} beams  sweep {sweep_ms:6.1f} ms  cast alone {plain_ms:6.1f} ms  "
            f"ratio {sweep_ms / plain_ms:5.1f}  {len(rays) / sweep_ms / 1e3:5.2f} M beams/s"
        )
    print(f"{label:10s} lidars: {total_ms:.0f} ms of processor time per simulated second")
    return beams


def processor_ms(step: Callable[[], object]) -> float:
    """Processor time of one call, over all threads."""
    start = time.process_time()
    step()
    return (time.process_time() - start) * 1e3


def whole_s(scenario_name: str, seconds: float) -> float:
    """Wall-clock time of the installed command for a recording of some length."""
    program = Path(sys.executable).with_name("lidcam")
    with TemporaryDirectory() as folder:
        command = [str(program), "simulate", scenario_name, f"{folder}/out.bag", "--duration", str(seconds)]
        begin = time.perf_counter()
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        return time.perf_counter() - begin


def main() -> None:
    """Print one line per sensor, and one per scenario."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*", default=["sandbox", "crossing", "vehicle"])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the recording that is timed as a whole")
    arguments = parser.parse_args()
    for scenario_name in arguments.scenarios:
        scenario = load_scenario(scenario_name)
        beams = measure_lidars(scenario_name, scenario, arguments.rounds)
        measure_cameras(scenario_name, scenario, arguments.rounds)
        pixels = sum(one.width_px * one.height_px * one.rate_hz for one in scenario.cameras.values())
        seconds = arguments.seconds
        took_s = whole_s(scenario_name, seconds) / seconds
        print(
            f"{scenario_name:10s} whole: {took_s:.2f} s per simulated second (over {seconds:g} s, start-up included); "
            f"{beams / took_s / 1e6:.2f} M beams/s and {pixels / took_s / 1e6:.1f} M pixels/s"
        )


if __name__ == "__main__":
    main()
