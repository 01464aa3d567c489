"""Plots of a run, by matplotlib: the map, speeds, counts."""

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from lidcam.notebook.counting import Line, LineCount, ends_of_lines
from lidcam.notebook.site_map import SiteMap
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.pipeline.evaluation.road_users import RoadUsers
from lidcam.writers.palette import class_color
from lidcam.writers.report.page import LIGHT_SHARE
from lidcam.writers.report.site_map import background_image, map_extent
from lidcam.writers.report.values import KM_H, nice
from lidcam.writers.tables.objects import Objects

INK, FAINT = "#1d2126", "#7a848d"
WIDTH_IN = 9.0

WAYS = "to the left", "to the right"
"""Directions across a line."""

SPEED_BINS = 12


def installed(package: str, wanted_by: str) -> Any:
    """An optional package."""
    try:
        return import_module(package)
    except ImportError as err:
        name = package.partition(".")[0].replace("_", "-")
        raise LidcamError(f"{wanted_by} needs {name}, which is not installed: pip install 'lidcam[notebook]'") from err


def plot_tracks(objects: Objects, site: SiteMap, rig: Rig, lines: Mapping[str, Line], axes: Any) -> Any:
    """All tracks from above, over what stands still; see `RunResult.plot`."""
    ends_by_name, places = ends_of_lines(lines), site.places(objects)
    known = np.flatnonzero(np.isfinite(places).all(1))
    objects, places = objects.select(known), places[known]
    low, high = map_extent([places, *([site.way[np.isfinite(site.way).all(1)]] if site.moves else [])], site.background)
    ratio = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.4, 1.0))
    axes = axes or _axes("run.plot()", (WIDTH_IN, WIDTH_IN * ratio + 0.4))
    if len(site.background):
        image, extent = background_image(site.background, low, high, 0.05 if site.moves else 0.2)
        axes.imshow(image, extent=extent, interpolation="nearest", zorder=0)
    for zone in rig.counted_zones if not site.moves else ():
        _outline(axes, zone.polygon_site, zone.name, low, high)
    for name, ends in ends_by_name.items():
        axes.plot(*ends.T, color=INK, linewidth=2.5, solid_capstyle="butt", zorder=4)
        _name_line(axes, name, ends)
    if site.moves and not site.is_adrift:
        axes.plot(*site.way.T, color=INK, linewidth=1.2, linestyle=":", label="path of the sensors", zorder=1)
    for class_id in np.unique(objects.class_ids).tolist():
        _plot_class(axes, objects, places, class_id)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.ticklabel_format(useOffset=False, style="plain")
    frame = "as seen from the moving sensors" if site.is_adrift else "in a fixed frame" if site.moves else "site frame"
    users = len(np.unique(objects.tracks[objects.tracks != NO_TRACK]))
    what = f"{users} road users" if users else f"{len(objects)} objects"
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_title(f"{what}, {frame}", loc="left", fontsize=11)
    _legend(axes, is_own=False)
    return axes


def _plot_class(axes: Any, objects: Objects, places: F64, class_id: int) -> None:
    """The tracks of a class: a line for each, with a dot where it was last; dots alone where there is no track."""
    color, name = _color(class_id), objects.class_names[class_id]
    rows = np.flatnonzero(objects.class_ids == class_id)
    order = rows[np.lexsort((objects.frames[rows], objects.tracks[rows]))]
    tracks = objects.tracks[order]
    is_tracked = tracks != NO_TRACK
    loose, order, tracks = order[~is_tracked], order[is_tracked], tracks[is_tracked]
    if len(order):
        cuts = np.flatnonzero(np.diff(tracks)) + 1
        xy = np.insert(places[order], cuts, np.nan, axis=0)  # a gap between tracks
        axes.plot(*xy.T, color=color, linewidth=1.8, label=f"{name} ({len(cuts) + 1})", zorder=3)
        ends = places[order[np.append(cuts - 1, len(order) - 1)]]
        axes.scatter(*ends.T, s=26, color=color, edgecolors="white", linewidths=0.8, zorder=3.5)
    if len(loose):
        label = None if len(order) else f"{name} ({len(loose)} boxes)"
        axes.scatter(*places[loose].T, s=4, color=color, label=label, linewidths=0, zorder=2)


def _outline(axes: Any, polygon: F64, name: str, low: F64, high: F64) -> None:
    closed = np.concatenate([polygon, polygon[:1]])
    axes.plot(*closed.T, color=FAINT, linewidth=1.2, linestyle="--", zorder=2)
    middle = (np.maximum(polygon.min(0), low) + np.minimum(polygon.max(0), high)) / 2
    if ((middle > low) & (middle < high)).all():
        axes.text(*middle, name, color=FAINT, ha="center", va="center", zorder=2)


def _name_line(axes: Any, name: str, ends: F64) -> None:
    """Write the name of a line beside its first end."""
    x, y = (ends[0] - ends[1]) / np.hypot(*(ends[0] - ends[1]))
    if abs(x) > abs(y):
        where = {"ha": "right" if x < 0 else "left", "va": "center"}
    else:
        where = {"ha": "center", "va": "top" if y < 0 else "bottom"}
    at = (6 * x, 6 * y)
    axes.annotate(name, ends[0], at, textcoords="offset points", color=INK, fontweight="bold", zorder=5, **where)


def plot_speeds(objects: Objects, axes: Any, *, km_h: bool) -> Any:
    """How many road users were how fast; see `RunResult.plot_speeds`."""
    is_own = axes is None
    axes = axes or _axes("run.plot_speeds()", (WIDTH_IN, 3.2))
    rows = np.flatnonzero((objects.tracks != NO_TRACK) & np.isfinite(objects.speeds))
    order = rows[np.argsort(objects.tracks[rows], kind="stable")]
    parts = np.split(order, np.flatnonzero(np.diff(objects.tracks[order])) + 1) if len(order) else []
    speeds = np.array([np.median(objects.speeds[part]) for part in parts]) * (KM_H if km_h else 1.0)
    classes = np.array([np.bincount(objects.class_ids[part]).argmax() for part in parts], np.int64)
    moved = np.array([objects.moving[part].any() for part in parts], np.bool_)
    axes.set_title(f"{moved.sum()} of {len(moved)} road users moved", loc="left", fontsize=11)
    speeds, classes = speeds[moved], classes[moved]
    fastest = max(float(speeds.max(initial=0.0)), 0.1)
    step = nice(fastest / SPEED_BINS)
    edges = np.arange(0, fastest + step, step)
    below = np.zeros(len(edges) - 1)
    for class_id in np.unique(classes).tolist():
        heights = np.histogram(speeds[classes == class_id], edges)[0]
        label = f"{objects.class_names[class_id]} ({(classes == class_id).sum()})"
        axes.bar(edges[:-1], heights, step * 0.94, below, align="edge", color=_color(class_id), label=label)
        below += heights
    axes.set(xlabel=f"median speed of each that moved, {'km/h' if km_h else 'm/s'}", ylabel="road users")
    _whole_numbers(axes, axes.yaxis)
    if not len(speeds):
        axes.text(0.5, 0.5, "no road user moved", transform=axes.transAxes, ha="center", color=FAINT)
        axes.set(xticks=[], yticks=[])
    _legend(axes, is_own=is_own)
    return axes


def plot_counts(
    users: RoadUsers, lines: Iterable[str], crossed: Sequence[LineCount], class_names: Sequence[str], axes: Any
) -> Any:
    """How many road users were where, and crossed what; see `RunResult.plot_counts`."""
    bars: dict[str, dict[str, int]] = {"everywhere": {}}
    for one in users.counts:
        bars.setdefault(one.zone or "everywhere", {})[one.class_name] = one.count
    bars |= {f"{line}, {way}": {} for line in lines for way in WAYS}
    for cross in crossed:
        for way, count in zip(WAYS, (cross.to_left, cross.to_right), strict=True):
            bars[f"{cross.line}, {way}"][cross.class_name] = count
    is_own = axes is None
    axes = axes or _axes("run.plot_counts()", (WIDTH_IN, 1.8 + 0.34 * max(len(bars) - 2, 0)))
    ends = np.zeros(len(bars))
    for class_id, name in enumerate(class_names):
        counts = np.array([counts.get(name, 0) for counts in bars.values()])
        if counts.any():
            axes.barh([*bars], counts, 0.7, ends, color=_color(class_id), label=name)
            ends += counts
    for row, end in enumerate(ends.tolist()):
        axes.annotate(f"{end:.0f}", (end, row), (4, 0), textcoords="offset points", va="center", color=INK)
    axes.invert_yaxis()
    axes.set(xlabel="road users, each counted once")
    _whole_numbers(axes, axes.xaxis)
    _legend(axes, is_own=is_own)
    return axes


def _axes(wanted_by: str, size_in: tuple[float, float]) -> Any:
    return installed("matplotlib.pyplot", wanted_by).subplots(figsize=size_in, layout="constrained")[1]


def _whole_numbers(axes: Any, axis: Any) -> None:
    """A plot of counts, along an axis: whole numbers, and no frame."""
    axis.get_major_locator().set_params(integer=True)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(axes: Any, *, is_own: bool) -> None:
    """A legend beside the axes of a figure of ours, else in them."""
    handles, labels = axes.get_legend_handles_labels()
    if handles and is_own:
        axes.figure.legend(handles, labels, loc="outside right upper", frameon=False)
    elif handles:
        axes.legend(loc="upper right", framealpha=0.8, markerscale=2)


def _color(class_id: int) -> tuple[float, ...]:
    """The colour of a class on a light ground, as on the page."""
    return tuple(LIGHT_SHARE * value for value in class_color(class_id))
