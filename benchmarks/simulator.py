"""What a simulated second costs, part by part, beside the casting of its rays alone, alternating in one run.

    python benchmarks/simulator.py [SCENARIO ...] [--rounds 20] [--seconds 10]

Lidars: a sweep of each, with what moves, edges, glass, noise and all else, and the same beams cast once at what stands
still. Cameras: the first image of each (of one that is fixed to the site it takes what stands still) and the later
ones, without JPEG. Milliseconds are medians of processor time, over all cores; means of the later images, as things
come and go. The whole: `lidcam simulate` with its start, on all cores, by the clock.
"""

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory
from typing import NamedTuple

from bags.simulator.recorder.movers import build_mover
from bags.simulator.scenario.load import load_scenario
from bags.simulator.scenario.scenario import Scenario
from bags.simulator.scenario.sensors import SensorScenario
from bags.simulator.sensors.beams import pattern_of
from bags.simulator.sensors.camera import Camera
from bags.simulator.sensors.lidar import Lidar
from bags.simulator.vehicles.traffic import Traffic
from bags.simulator.world.motion import FixedPath, MountedPath, Path
from bags.simulator.world.places.places import static_mesh
from bags.simulator.world.scene import Scene

WARM_UP_S = 2.0


class LidarCost(NamedTuple):
    """Of one lidar.

    Attributes:
        rays: Beams of a sweep.
        sweep_ms: Processor time of a sweep.
        plain_ms: Processor time of casting its beams once at what stands still.
        sweeps_per_s: Of the scenario.
    """

    rays: int
    sweep_ms: float
    plain_ms: float
    sweeps_per_s: float


class CameraCost(NamedTuple):
    """Of one camera.

    Attributes:
        first_ms: Processor time of its first image.
        image_ms: Processor time of a later one.
        pixels_moving: Pixels of an image that show what moves.
        images_per_s: Of the scenario.
    """

    first_ms: float
    image_ms: float
    pixels_moving: int
    images_per_s: float


def simulated(scenario: Scenario, rounds: int) -> tuple[Traffic, Scene]:
    """A scenario that has gone on for as long as the slowest sensor needs."""
    traffic = Traffic(scenario)
    sensors: list[SensorScenario] = [*scenario.lidars.values(), *scenario.cameras.values()]
    last_s = WARM_UP_S + (rounds + 2) / min((sensor.rate_hz for sensor in sensors), default=10.0)
    traffic.advance(round(last_s * 1e9))
    others = {name: vehicle for name, vehicle in scenario.vehicles.items() if not vehicle.ego}
    movers = [build_mover(name, vehicle, traffic.trajectories[name]) for name, vehicle in others.items()]
    return traffic, Scene(static_mesh(scenario.world), movers)


def path_of(sensor: SensorScenario, scenario: Scenario, traffic: Traffic) -> Path:
    """Of a sensor's body."""
    place = sensor.T_carrier_body(sensor.mounted_on or scenario.site_frame)
    carrier = traffic.trajectories.get(sensor.mounted_on)
    return FixedPath(place) if carrier is None else MountedPath(carrier, place)


def camera_costs(scenario: Scenario, rounds: int) -> Iterator[tuple[str, CameraCost]]:
    """Each camera of a scenario, some seconds after its beginning."""
    traffic, scene = simulated(scenario, rounds)
    for name, settings in scenario.cameras.items():
        camera = Camera(name, settings, path_of(settings, scenario, traffic), scene, scenario.sun, scenario.seed)
        first = round(WARM_UP_S * settings.rate_hz)
        times_ns = [round(number * 1e9 / settings.rate_hz) for number in range(first, first + rounds + 1)]
        costs = [processor_ms(partial(camera.image, number, time_ns)) for number, time_ns in enumerate(times_ns)]
        moving = int(camera.image(0, times_ns[len(times_ns) // 2]).seen_px.sum())
        yield name, CameraCost(costs[0], statistics.mean(costs[1:]), moving, settings.rate_hz)


def lidar_costs(scenario: Scenario, rounds: int) -> Iterator[tuple[str, LidarCost]]:
    """Each lidar of a scenario, some seconds after its beginning."""
    traffic, scene = simulated(scenario, rounds)
    for name, settings in scenario.lidars.items():
        lidar = Lidar(name, settings, path_of(settings, scenario, traffic), scene, scenario.seed)
        first = round(WARM_UP_S * settings.rate_hz)
        rays = lidar.rays(pattern_of(settings).beams(first))
        sweeps, plain = [], []
        for number in range(rounds):
            plain.append(processor_ms(partial(scene.cast_static, rays)))
            sweeps.append(processor_ms(partial(lidar.sweep, first + number)))
        yield name, LidarCost(len(rays), statistics.median(sweeps), statistics.median(plain), settings.rate_hz)


def processor_ms(step: Callable[[], object]) -> float:
    """Processor time of one call, over all threads."""
    start = time.process_time()
    step()
    return (time.process_time() - start) * 1e3


def whole_s(scenario_name: str, seconds: float) -> float:
    """How long the installed command takes for a recording of some length."""
    program = FilePath(sys.executable).with_name("lidcam")
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
    parser.add_argument("--seconds", type=float, default=10.0, help="of the whole")
    arguments = parser.parse_args()
    for scenario_name in arguments.scenarios:
        scenario, beams = load_scenario(scenario_name), 0.0
        total_ms = 0.0
        for name, cost in lidar_costs(scenario, arguments.rounds):
            total_ms += cost.sweep_ms * cost.sweeps_per_s
            beams += cost.rays * cost.sweeps_per_s
            print(
                f"{scenario_name:10s} {name:12s} {cost.rays:7d} beams  sweep {cost.sweep_ms:6.1f} ms  "
                f"cast alone {cost.plain_ms:6.1f} ms  ratio {cost.sweep_ms / cost.plain_ms:5.1f}  "
                f"{cost.rays / cost.sweep_ms / 1e3:5.2f} M beams/s"
            )
        print(f"{scenario_name:10s} lidars: {total_ms:.0f} ms of processor time per simulated second")
        total_ms = 0.0
        for name, seen in camera_costs(scenario, arguments.rounds):
            total_ms += seen.image_ms * seen.images_per_s
            print(
                f"{scenario_name:10s} {name:12s} first image {seen.first_ms:6.0f} ms  "
                f"later ones {seen.image_ms:6.1f} ms  {seen.pixels_moving} pixels of what moves"
            )
        print(f"{scenario_name:10s} cameras: {total_ms:.0f} ms of processor time per simulated second")
        pixels = sum(one.width_px * one.height_px * one.rate_hz for one in scenario.cameras.values())
        seconds = arguments.seconds
        took_s = whole_s(scenario_name, seconds) / seconds
        print(
            f"{scenario_name:10s} whole: {took_s:.2f} s per simulated second (of {seconds:g}, with start); "
            f"{beams / took_s / 1e6:.2f} M beams/s and {pixels / took_s / 1e6:.1f} M pixels/s"
        )


if __name__ == "__main__":
    main()
