"""Scenarios drawn from a seed, of three families.

`road`: a car with a lidar on its roof in a street, often with a junction. `crossing`: lidars on masts and tripods at a
junction. `sandbox`: a table with model cars, and lidars at its edge. What is varied, and how far, follows what real
recordings have and the bundled scenarios lack: clutter of the size of cars and people, plants, poles and bins beside
people, sizes and headings, intensities, lost returns, uneven ground.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.scenario.scenario import (
    GroundScenario,
    RoadScenario,
    Scenario,
    ThingScenario,
    VehicleScenario,
)
from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario
from lidcam.bags.simulator.vehicles.footprints import Rectangle, overlap, things_in_the_way
from lidcam.bags.simulator.world.places.open_world import open_height
from lidcam.bags.simulator.worlds.site import Site, clutter, frontage, island
from lidcam.readers.velodyne.models import built_in_table

Family = Literal["sandbox", "crossing", "road"]

TRIES = 20
REACH_M = 90.0  # roads, and what lines them, end here


def _even(low: float, high: float, beams: int) -> tuple[float, ...]:
    return tuple(np.linspace(low, high, beams).round(3).tolist())


def _velodyne(model: str) -> tuple[float, ...]:
    return tuple(np.sort(np.rad2deg(built_in_table(model).elevation_rad)).round(3).tolist())


_PANDAR_LOW = (-25.0, -19.0, -14.0, -13.0, -12.0, -11.0, -10.0, -9.0, -8.0, -7.0)
_PANDAR_HIGH = (3.0, 5.0, 8.0, 11.0, 15.0)

LAYOUTS: Mapping[str, tuple[float, ...]] = {
    "VLP-16": _velodyne("VLP-16"),
    "Puck Hi-Res": _velodyne("Puck Hi-Res"),
    "HDL-32E": _velodyne("HDL-32E"),
    "VLP-32C": _velodyne("VLP-32C"),
    # An upper block at a third of a degree, a lower one at half a degree (manual 63-HDL64ES3); each unit differs.
    "HDL-64E": _even(-24.33, -8.83, 32) + _even(-8.33, 2.0, 32),
    # Dense near the horizon, as the VLP-32C (63-9483).
    "VLS-128": (
        *(-25.0, -19.58, -16.04, -13.57, -11.74, -10.35, -9.24, -8.35, -7.65, -7.15),
        *_even(-6.85, 4.9, 108),
        *(5.2, 5.5, 5.9, 6.4, 7.0, 7.9, 9.0, 10.3, 12.2, 15.0),
    ),
    "OS0-64": _even(-45.0, 45.0, 64),
    "OS1-16": _even(-16.6, 16.6, 16),
    "OS1-32": _even(-22.5, 22.5, 32),
    "OS1-64": _even(-16.6, 16.6, 64),
    "OS1-128": _even(-22.5, 22.5, 128),
    "OS2-64": _even(-11.25, 11.25, 64),
    # A sixth of a degree from -6 to 2 degrees, wider outside (Pandar64 manual, appendix I).
    "Pandar64": (*_PANDAR_LOW, *_even(-6.0, 2.0, 49), *_PANDAR_HIGH),
    "Pandar40": (*_PANDAR_LOW, *_even(-6.0, 2.0, 25), *_PANDAR_HIGH),
    "PandarXT-32": _even(-16.0, 15.0, 32),
}
"""Elevations of the beams of lidars on the market by model, degrees, rising; even where a manual has limits alone."""


def random_numbers_of(family: Family, *numbers: int) -> np.random.Generator:
    """The random numbers of one thing of one family."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([crc32(family.encode()), *numbers])))


def random_scenario(family: Family, seed: int) -> Scenario:
    """The scenario of a family and a seed, always the same, with exact sensors; see `errors.with_errors`."""
    draw = random_numbers_of(family, seed)
    tree = _table(draw) if family == "sandbox" else _street(draw, family)
    ego = "ego" in tree["vehicles"]
    lidar = random_lidar(family, draw, tree["ground"], tree["things"])
    topics = {"topic": "/camera/image_raw", "info_topic": "/camera/camera_info", "frame_id": "camera_optical"}
    pose = {"position_m": lidar.position_m, "rpy_deg": (0.0, 0.0 if ego else 15.0, lidar.rpy_deg[2])}
    lens = {"width_px": 800, "height_px": 500, "focal_px": (560.0, 560.0), "detector": {"topic": "/camera/detections"}}
    camera = CameraScenario.model_validate({"mounted_on": lidar.mounted_on, **topics, **pose, **lens})
    return Scenario(
        description=f"Drawn: {family}, seed {seed}.",
        world="open",
        site_frame="odom" if ego else "site",
        seed=seed,
        lidars={"top": lidar},
        cameras={"front": camera},
        **tree,
    )


def random_lidar(
    family: Family, draw: np.random.Generator, ground: GroundScenario, things: Sequence[ThingScenario]
) -> LidarScenario:
    """A lidar, its place and its faults; on the roof of a car, a mast, or at a table, as the family has it.

    It stands on the ground, and in none of the things.
    """
    site = Site(draw)
    names = list(LAYOUTS)
    name = names[int(draw.integers(len(names)))] if not site.chance(0.15) else "HDL-64E"
    elevations = LAYOUTS[name]
    site_scale = 1.0
    tilt = (site.about(0, 1.0, -4, 4), site.about(0, 1.2, -4, 4), 0.0)
    place = (site.between(0.2, 1.6), site.between(-0.3, 0.3), site.about(1.85, 0.2, 1.4, 2.8))
    if family == "crossing":
        high = site.between(3.0, 8.0) if site.chance(0.7) else site.between(1.2, 2.5)
        place = (*_free_corner(site, things), high)
        inward = math.degrees(math.atan2(-place[1], -place[0]))
        down = site.between(0, 25) if high > 3 else site.between(-2, 3)
        tilt = (site.about(0, 2, -6, 6), down, round(inward + site.between(-30, 30), 2))
    elif family == "sandbox":
        site_scale = 0.1
        turn = site.between(0, 2 * math.pi)
        away = site.between(0.5, 2.4)
        place = (round(away * math.cos(turn), 3), round(away * math.sin(turn), 3), site.between(0.3, 1.1))
        roll, pitch = site.about(0, 3, -10, 10), site.between(0, 25)
        tilt = (roll, pitch, round(math.degrees(turn) + 180 + site.between(-30, 30), 2))
    if family != "road":
        x, y, high = place
        place = (x, y, round(high + float(open_height(ground, np.array([[x, y]]))[0]), 3))
    gain = site.between(0.7, 6.0)
    columns = min(int(site.pick(900, 1024, 1200, 1800, 1800, 2048)), 1200 if len(elevations) > 64 else 2048)
    return LidarScenario(
        topic="/lidar/points",
        frame_id="lidar",
        mounted_on="ego" if family == "road" else "",
        position_m=place,
        rpy_deg=tilt,
        model="linear",
        elevations_deg=tuple(round(angle + site.about(0, 0.02, -0.05, 0.05), 3) for angle in elevations),
        columns=columns,
        max_range_m=site.between(120, 350),
        range_noise_m=site.between(0.004, 0.03) * max(site_scale, 0.3),
        dropout=site.pick(0.005, site.between(0.02, 0.09), site.between(0.02, 0.09)),
        intensity_gain=gain,
        intensity_floor=round(gain * site.pick(0.0, site.between(2, 12), site.between(2, 12)), 3),
    )


def _free_corner(site: Site, things: Sequence[ThingScenario]) -> tuple[float, float]:
    """A place near a corner of the junction for the foot of a mast; where none is free, the last that was tried."""
    taken = things_in_the_way(things, step_m=0.2, headroom_m=10.0)
    for _ in range(TRIES):
        x, y = site.pick(-1, 1) * site.between(4, 14), site.pick(-1, 1) * site.between(6, 12)
        if not any(overlap(Rectangle(x, y, 0.0, 0.6, 0.6), other) for other in taken):
            break
    return x, y


def _street(draw: np.random.Generator, family: Family) -> dict[str, Any]:
    """Ground, things, routes and road users of a street along x, and of one along y that crosses it."""
    site = Site(draw)
    width, parking = site.between(5.5, 11), site.pick(0.0, 2.2, 2.2)
    crosses = family == "crossing" or site.chance(0.6)
    cross_x = 0.0 if family == "crossing" else site.between(-40, 40)
    cross_width = site.between(4.5, 10)
    half, cross_half = width / 2 + parking, cross_width / 2 if crosses else 0.0
    roads = [RoadScenario(from_m=(-REACH_M, 0.0), to_m=(REACH_M, 0.0), width_m=2 * half)]
    if crosses:
        roads.append(RoadScenario(from_m=(cross_x, -REACH_M), to_m=(cross_x, REACH_M), width_m=cross_width))
    steep = 0.03 if site.chance(0.5) else 0.0
    ground = GroundScenario(
        reach_m=130.0,
        roads=tuple(roads),
        kerb_m=site.pick(0.0, 0.06, 0.12, 0.15),
        slope=(site.between(-steep, steep or 1e-9), site.between(-steep, steep or 1e-9)),
        waves_m=site.pick(0.0, site.between(0.1, 1.2)),
        wave_length_m=site.between(40, 110),
        roughness_m=site.between(0.002, 0.05),
        seed=int(draw.integers(1 << 30)),
    )
    paved = site.between(1.2, 5.0)

    lane = width / 4
    site.route("east", ((-REACH_M, -lane), (REACH_M, -lane)))
    site.route("west", ((REACH_M, lane), (-REACH_M, lane)))
    if crosses:
        lane = cross_width / 4
        site.route("north", ((cross_x + lane, -REACH_M), (cross_x + lane, REACH_M)), ("east", "west"))
        site.route("south", ((cross_x - lane, REACH_M), (cross_x - lane, -REACH_M)), ("east", "west"))
    for name, side in (("left_pavement", 1), ("right_pavement", -1)):
        y = side * (half + paved * 0.4)
        site.route(name, ((-REACH_M, y), (REACH_M, y)))
    lanes = [name for name in site.routes if "pavement" not in name]

    if family == "road":
        way = {"route": "east", "route_start_m": site.between(50, 110), "speed_m_s": site.between(0, 12)}
        site.user(VehicleScenario.model_validate({"shape": "car", "ego": True, "odometry": True, **way}))
    for _ in range(int(draw.integers(1, 8))):
        site.on_route(site.car, site.pick(*lanes), (3.0, 13.0))
    for _ in range(int(draw.integers(0, 4))):
        site.on_route(site.large, site.pick(*lanes), (3.0, 11.0))
    for _ in range(int(draw.integers(1, 5))):
        site.on_route(site.cyclist, site.pick(*lanes), (2.0, 6.0))
    for _ in range(int(draw.integers(1, 5))):
        site.on_route(site.pedestrian, site.pick("left_pavement", "right_pavement"), (0.6, 1.8))

    _parked(site, half, parking, cross_x, cross_half)
    _people(site, half, paved)
    density = site.between(0.3, 1.0)
    for side in (1, -1):
        for _ in range(int(density * 150)):
            x = site.about(0, 45, -REACH_M, REACH_M)
            y = half + (site.between(0.5, paved + 4) if site.chance(0.6) else site.between(paved, 30))
            if abs(x - cross_x) > cross_half + 1:
                clutter(site, (x, side * y), 0.0)
        for begin, end in ((-REACH_M, cross_x - cross_half - 3), (cross_x + cross_half + 3, REACH_M)):
            start = (begin, side * (half + paved)) if side > 0 else (end, side * (half + paved))
            frontage(site, start, 0.0 if side > 0 else 180.0, end - begin)
        if crosses:
            for beside, yaw in ((1, -90.0), (-1, 90.0)):
                x = cross_x + beside * (cross_half + 3)
                far, near = side * REACH_M, side * (half + paved + 3)
                y = max(far, near) if yaw < 0 else min(far, near)
                frontage(site, (x, y), yaw, abs(far - near))
    return {"ground": ground, "things": tuple(site.things), "routes": site.routes, "vehicles": site.vehicles}


def _parked(site: Site, half: float, parking: float, cross_x: float, cross_half: float) -> None:
    """Vehicles at the kerb, along or across, with planted beds between them, and in yards at any heading."""
    for side in (1, -1):
        across, full = site.chance(0.25), site.between(0.0, 1.0)
        planted = site.pick(0.0, 0.1, 0.35)
        along = -REACH_M + site.between(0, 6)
        while along < REACH_M:
            step = site.between(2.5, 3.4) if across else site.between(4.9, 7.0)
            if abs(along - cross_x) > cross_half + 6:
                row_deg = 90.0 if across else 0.0
                y = half + site.between(2.2, 3.2) if across else half - (parking / 2 if parking else -1.3)
                if site.chance(full * 0.8):
                    heading = site.pick(0.0, 180.0) + row_deg + site.about(0, 3, -10, 10)
                    _at_rest(site.large if site.chance(0.08) else site.car, along, side * y, heading)
                elif site.chance(planted):
                    island(site, (along, side * y), row_deg)
            along += step
    for _ in range(int(site.draw.integers(0, 12))):
        y = site.pick(-1, 1) * site.between(half + 3, half + 25)
        _at_rest(site.large if site.chance(0.2) else site.car, site.between(-70, 70), y, site.between(0, 360))


def _at_rest(add: Callable[..., bool], x: float, y: float, heading_deg: float) -> None:
    """Add a vehicle about whose middle lies at a place."""
    turn, back = math.radians(heading_deg), 1.3
    start = (round(x - back * math.cos(turn), 3), round(y - back * math.sin(turn), 3), round(heading_deg, 2))
    add(start=start)


def _people(site: Site, half: float, paved: float) -> None:
    """People alone and in groups, on pavements, roads and beside what stands there, and cyclists at rest."""
    for _ in range(int(site.draw.integers(4, 18))):
        x = site.about(0, 28, -80, 80)
        y = site.pick(-1, 1) * site.between(half * (0.2 if site.chance(0.2) else 1.0) + 0.4, half + paved + 3)
        heading = site.between(0, 360)
        for number in range(int(site.pick(1, 1, 1, 2, 2, 3, 5, 8))):
            close = site.between(0.5, 1.1) * math.sqrt(number)
            start = (round(x + close * site.between(-1, 1), 3), round(y + close * site.between(-1, 1), 3), heading)
            site.pedestrian(start=start, margin_m=0.02)
        for _ in range(int(site.draw.integers(0, 4))):  # a pole, a bush, a bin within reach
            off, turn = site.between(0.4, 1.8), site.between(0, 2 * math.pi)
            clutter(site, (x + off * math.cos(turn), y + off * math.sin(turn)), 0.0)
    for _ in range(int(site.draw.integers(3, 9))):
        x, y = site.about(0, 28, -80, 80), site.pick(-1, 1) * site.between(half * 0.6, half + paved)
        heading = site.pick(0.0, 180.0) + site.about(0, 15, -60, 60) if site.chance(0.6) else site.between(0, 360)
        site.cyclist(start=(x, y, round(heading, 2)))


def _table(draw: np.random.Generator) -> dict[str, Any]:
    """A table with model cars, things of their size, and the walls of a room."""
    site = Site(draw, step_m=0.03, headroom_m=0.22)
    reach = site.between(1.8, 4.0)
    inner, road_m = reach - 0.4, site.between(0.6, 1.1)
    along = RoadScenario(from_m=(-reach, 0.0), to_m=(reach, 0.0), width_m=road_m)
    across = RoadScenario(from_m=(0.3, -reach), to_m=(0.3, reach), width_m=road_m)
    ground = GroundScenario(
        reach_m=max(reach + 1, 4.5),
        roads=(along, across),
        roughness_m=site.between(0.0, 0.004),
        seed=int(draw.integers(1 << 30)),
        kerb_m=0.0,
    )
    site.route("along", ((-reach, 0.0), (reach, 0.0)))
    site.route("across", ((0.3, -reach), (0.3, reach)), ("along",))

    def model(**place: Any) -> bool:
        scale = tuple(site.about(1.0, 0.12, 0.75, 1.4) for _ in range(3))
        return site.user(VehicleScenario(shape="model_car", scale=scale, color=site.color(), **place), margin_m=0.02)

    for name in ("along", "across"):
        for _ in range(int(draw.integers(0, 3))):
            start_m = site.between(0.2, 2 * reach - 0.6)
            model(route=name, route_start_m=start_m, speed_m_s=site.between(0.1, 0.4))
    for _ in range(int(draw.integers(2, 10))):
        model(start=(site.between(-inner, inner), site.between(-inner, inner), site.between(0, 360)))
    for _ in range(int(draw.integers(15, 60))):
        kind = site.pick("box", "box", "cylinder", "cone", "bush", "lump", "fence")
        size = (site.between(0.02, 0.6), site.between(0.02, 0.3), site.between(0.05, 0.5))
        if kind in ("cylinder", "cone"):
            size = (size[1], size[1], size[2])
        x, y = site.between(-reach, reach), site.between(-reach, reach)
        if min(abs(y), abs(x - 0.3)) > 0.3:
            site.thing(kind, x, y, size, yaw_deg=site.between(0, 360), margin_m=0.01)
    for turn in (0, 90, 180, 270):  # the room; a side of the table may have an edge
        wall, edge = (reach + site.between(0.5, 4), 2.6, 0.9), (reach + 0.1, site.between(0.05, 0.4), 0.4)
        for away, high, share in (wall, edge):
            if site.chance(share):
                x, y = away * math.cos(math.radians(turn)), away * math.sin(math.radians(turn))
                site.thing("box", x, y, (0.04, 2 * away, high), yaw_deg=turn, margin_m=-1.0)
    return {"ground": ground, "things": tuple(site.things), "routes": site.routes, "vehicles": site.vehicles}
