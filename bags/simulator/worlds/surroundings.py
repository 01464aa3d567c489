"""Things beside roads: some of the size of a car or a person, others that close the view."""

import math
from functools import partial

from lidcam.bags.simulator.worlds.site import Site

Place = tuple[float, float]


def clutter(site: Site, at: Place, yaw_deg: float) -> None:
    """Add one thing, or a few, of the kinds that are taken for road users, at a place on open ground."""
    CLUTTER[int(site.draw.integers(len(CLUTTER)))](site, at, yaw_deg)


def frontage(site: Site, begin: Place, yaw_deg: float, length_m: float) -> None:
    """Line a road: buildings, walls, fences, hedges, trees and bushes one after another, and gaps.

    It begins at a place and runs `length_m` along `yaw_deg`; things stand on its left.
    """
    done, place = site.between(0, 6), partial(_beside, begin, yaw_deg)
    while done < length_m:
        kind = site.pick("building", "building", "wall", "fence", "hedge", "bushes", "bushes", "trees", "gap", "wild")
        piece = site.between(4, 22)
        middle = done + piece / 2
        deep = 0.0 if kind in ("wall", "fence", "hedge") else site.between(0, 6)
        x, y = place(middle, deep)
        if kind == "building":
            depth, high = site.between(5, 12), site.between(2.5, 14)
            x, y = place(middle, deep + depth / 2)
            site.thing("box", x, y, (piece, depth, high), yaw_deg=yaw_deg)
            for _ in range(int(site.draw.integers(0, 5))):  # doorways, bays, drain pipes, steps
                bay = place(done + site.between(0.5, max(piece - 0.5, 0.6)), deep - 0.25)
                size = (site.between(0.1, 1.6), site.between(0.1, 0.45), site.between(0.3, min(high, 3.0)))
                site.thing("box", *bay, size, yaw_deg=yaw_deg, margin_m=0.0)
        elif kind == "wall":
            site.thing("box", x, y, (piece, site.between(0.15, 0.4), site.between(0.4, 2.2)), yaw_deg=yaw_deg)
        elif kind == "fence":
            bent = yaw_deg + site.between(-8, 8)
            site.thing("fence", x, y, (piece, 0.08, site.between(0.7, 2.0)), yaw_deg=bent)
        elif kind == "hedge":
            for number in range(max(int(piece / 4), 1)):  # leaves keep their size
                x, y = place(done + 2 + 4 * number, 0.0)
                site.thing("hedge", x, y, (4.0, site.between(0.5, 1.4), site.between(0.6, 2.2)), yaw_deg=yaw_deg)
        elif kind in ("bushes", "wild"):
            for _ in range(int(piece / (1.5 if kind == "wild" else 2.5)) + 1):
                x, y = place(done + site.between(0, piece), site.between(0, 8 if kind == "wild" else 2))
                plant(site, (x, y))
        elif kind == "trees":
            for ahead in (1.0, piece / 2, piece - 1.0):
                tree(site, place(done + ahead, site.between(0.5, 3)))
        if kind == "gap":
            for _ in range(int(piece / 5)):
                clutter(site, place(done + site.between(0, piece), site.between(0, 8)), yaw_deg)
        done += piece + (site.between(0, 5) if site.chance(0.5) else 0.2)


def _beside(at: Place, yaw_deg: float, ahead: float, left: float = 0.0) -> Place:
    """The place so far ahead and to the left of another one, along a heading."""
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return at[0] + ahead * cos - left * sin, at[1] + ahead * sin + left * cos


def island(site: Site, at: Place, yaw_deg: float) -> None:
    """Add a planted bed with low shrubs, as long as a parked car and in its place, often with a tree."""
    turned = yaw_deg + site.between(-6, 6)
    kind = site.pick("hedge", "hedge", "bush", "bush", "box")
    size = (site.between(2.0, 5.5), site.between(1.0, 2.3), site.between(0.3, 1.5))
    if not site.thing(kind, *at, size, yaw_deg=turned, color=_green(site)):
        return
    for _ in range(int(site.draw.integers(0, 3))):
        wide = site.between(0.5, size[1])
        place = _beside(at, turned, site.between(-0.5, 0.5) * (size[0] - wide))
        size_of_bush = (wide, wide * site.between(0.6, 1.0), site.between(0.4, 1.8))
        site.thing("bush", *place, size_of_bush, yaw_deg=turned, color=_green(site), margin_m=-1.0)
    if site.chance(0.6):
        wide, high = site.between(2.0, 6.0), site.between(3.0, 9.0)
        site.thing("tree", *at, (wide, wide, high), yaw_deg=turned, color=_green(site), margin_m=-1.0)


def plant(site: Site, at: Place) -> None:
    """Add a bush, from knee height to that of a van, or grass."""
    wide, high = site.between(0.4, 3.6), site.between(0.4, 2.2 if site.chance(0.5) else 4.0)
    kind = site.pick("bush", "bush", "bush", "grass", "conifer")
    if kind == "grass":
        wide, high = site.between(1, 4), site.between(0.25, 1.0)
    elif kind == "conifer":
        wide, high = site.between(0.5, 2.0), site.between(1.0, 5.0)
    size = (wide, wide * site.between(0.5, 1.4), high)
    site.thing(kind, *at, size, yaw_deg=site.between(0, 180), color=_green(site), margin_m=0.0)


def tree(site: Site, at: Place) -> None:
    """Add a tree."""
    wide, high = site.between(1.5, 7), site.between(2.5, 11)
    kind = site.pick("tree", "tree", "tree", "conifer")
    site.thing(kind, *at, (wide, wide, high), yaw_deg=site.between(0, 360), color=_green(site))


def _green(site: Site) -> tuple[float, float, float]:
    return site.between(0.15, 0.4), site.between(0.28, 0.5), site.between(0.1, 0.25)


def _pole(site: Site, at: Place, yaw_deg: float) -> None:
    thick = site.pick(0.06, 0.08, 0.1, 0.15, 0.2, 0.3, 0.4)
    high = site.between(0.8, 8)
    if site.thing("cylinder", *at, (thick, thick, high)) and site.chance(0.5):
        wide = site.between(0.3, 1.2)
        low = round(max(high - site.between(0.4, 1.4), 0.1), 3)
        turned = yaw_deg + site.pick(0, 90) + site.between(-10, 10)
        shiny = site.pick(0.4, 2.0, 3.0)
        size, (x, y) = (0.03, wide, site.between(0.3, 0.9)), _beside(at, turned, thick / 2 + 0.03)
        site.thing("box", x, y, size, yaw_deg=turned, bottom_m=low, reflectivity=shiny, margin_m=0.0)


def _furniture(site: Site, at: Place, yaw_deg: float) -> None:
    """A bin, a cabinet, a crate, a bollard..."""
    kind = site.pick("box", "box", "cylinder", "cone", "table", "lump")
    size = (site.between(0.25, 1.4), site.between(0.25, 0.9), site.between(0.4, 1.9))
    if kind in ("cylinder", "cone"):
        size = (size[1], size[1], size[2])
    site.thing(kind, *at, size, yaw_deg=yaw_deg + site.pick(0, 90) + site.between(-10, 10))


def _person_sized(site: Site, at: Place, yaw_deg: float) -> None:
    """A post, a statue, a parking meter, a traffic light, a dustbin on a pole: as high and wide as a person."""
    high, wide = site.between(1.1, 2.3), site.between(0.15, 0.65)
    kind = site.pick("cylinder", "box", "cone", "lump", "bush", "conifer")
    if site.chance(0.6):
        site.thing(kind, *at, (wide, wide * site.between(0.5, 1.0), high), yaw_deg=yaw_deg + site.between(0, 90))
        return
    thick, head = site.between(0.06, 0.2), site.between(0.25, 1.2)
    low = round(max(high - head - site.between(0.0, 0.3), 0.1), 3)
    size = (max(wide, 0.22), max(wide * site.between(0.5, 1.0), 0.22), head)
    if site.thing("box", *at, size, yaw_deg=yaw_deg + site.between(0, 90), bottom_m=low):
        site.thing("cylinder", *at, (thick, thick, high), margin_m=-1.0)


def _bicycles(site: Site, at: Place, yaw_deg: float) -> None:
    """A row of parked bicycles."""
    for number in range(int(site.draw.integers(1, 6))):
        x, y = _beside(at, yaw_deg, 0.6 * number)
        size = (site.between(1.5, 1.85), site.between(0.45, 0.65), site.between(0.95, 1.15))
        site.thing("bicycle", x, y, size, yaw_deg=yaw_deg + 90 + site.between(-15, 15))


def _plants(site: Site, at: Place, yaw_deg: float) -> None:
    """A few bushes close together, or bushes in a row as long as a car."""
    for number in range(int(site.draw.integers(1, 5))):
        plant(site, _beside(at, yaw_deg, site.between(0.5, 1.2) * number, site.between(-0.4, 0.4)))


def _car_sized(site: Site, at: Place, yaw_deg: float) -> None:
    """A skip, a shed, a trailer, a block of hedge, a heap: as large as a car, or as a van."""
    kind = site.pick("box", "box", "hedge", "lump", "bush", "fence")
    size = (site.between(2.2, 5.5), site.between(1.2, 2.6), site.between(0.9, 2.6))
    if kind == "fence":
        size = (size[0], 0.1, size[2])
    site.thing(kind, *at, size, yaw_deg=yaw_deg + site.pick(0, 0, 90) + site.between(-15, 15))


def _large(site: Site, at: Place, yaw_deg: float) -> None:
    """A piece of wall, a container, a kiosk, a bus shelter: higher than a car."""
    kind = site.pick("box", "box", "hedge", "bush", "fence")
    size = (site.between(2.0, 9.0), site.between(0.3, 3.0), site.between(1.8, 4.2))
    if kind == "fence":
        size = (size[0], 0.15, size[2])
    site.thing(kind, *at, size, yaw_deg=yaw_deg + site.pick(0, 0, 90) + site.between(-15, 15))


CLUTTER = (
    *(_pole, _pole, _person_sized, _person_sized, _furniture, _furniture),
    *(_bicycles, _plants, _plants, _car_sized, _large, lambda site, at, _: tree(site, at)),
)
