"""The map of a page: all tracks from above, over what stands still."""

import base64
from collections.abc import Sequence

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.geometry.polygons import clipped_polygon
from lidcam.pipeline.core.rig import Rig
from lidcam.writers.report.collector import ReportCollector
from lidcam.writers.report.grid import SparseGrid
from lidcam.writers.report.values import KM_H, Figure, axis, nice, rounded, trace

MAX_PIXELS = 1400
"""Pixels along the longer side of the background."""

SPEED_STEPS = 6


def map_figure(seen: ReportCollector, rig: Rig, background: SparseGrid | None, class_names: Sequence[str]) -> Figure:
    """All tracks from above, over what stands still, with the zones; by class, and by speed."""
    table = seen.users.table
    lines = dict(seen.courses.lines())
    known = {number: line[np.isfinite(line[:, 2])] for number, line in lines.items()}  # where speeds are known
    classes = dict(zip(seen.users.numbers, table.class_ids.tolist(), strict=True))
    drawn = [line[:, :2] for line in lines.values()] + [grid.centers for grid in seen.places.values()]
    low, high = map_extent(drawn, background)
    traces = [*_zones(rig, low, high)] if not seen.travelled_m else []
    traces += _way(seen)
    traces += [_dots(grid, name, class_names.index(name)) for name, grid in sorted(seen.places.items())]
    for class_id, name in enumerate(class_names):
        own = [number for number in lines if classes.get(number) == class_id]
        if own:
            traces.append(_line(name, f"@class:{class_id}", [known[number] for number in own], "by class"))
            traces.append(_ends(name, f"@class:{class_id}", [lines[number] for number in own], "by class"))
    pieces = _by_speed(list(known.values())) if lines else []
    traces, views = traces + pieces, ["by class", "by speed"] if pieces else []
    least = 0.05 if seen.travelled_m else 0.2  # what drives by a rig that stands is seldom in one place
    layout = {
        "xaxis": axis("x, m", range=[low[0], high[0]], constrain="domain"),
        "yaxis": axis("y, m", range=[low[1], high[1]], scaleanchor="x", constrain="domain"),
        "images": [] if background is None or not len(background) else [_image(background, low, high, least)],
        "hovermode": "closest",
    }
    ratio = float((high[1] - low[1]) / (high[0] - low[0]))
    return {"data": traces, "layout": layout, "views": views, "ratio": min(max(ratio, 0.35), 1.0)}


def map_extent(drawn: Sequence[F64], background: SparseGrid | None) -> tuple[F64, F64]:
    """Lower left and upper right of what is shown: all tracks, with room around them; most points, if that is more."""
    places = np.concatenate([*drawn, np.zeros((0, 2))])
    if background is not None and len(background):
        around = np.percentile(background.centers, [2, 98], axis=0)
        if not len(places) or np.ptp(places, axis=0).max() < np.ptp(around, axis=0).max():
            places = np.concatenate([places, around])
    if not len(places):
        return np.array([-10.0, -10.0]), np.array([10.0, 10.0])
    low, high = places.min(0), places.max(0)
    size = max(*(high - low), 0.5)
    middle, reach = (low + high) / 2, np.maximum((high - low) / 2 + 0.12 * size, 0.3 * size)
    return np.round(middle - reach, 3), np.round(middle + reach, 3)


def _image(background: SparseGrid, low: F64, high: F64, least: float) -> Figure:
    """Standing surroundings as an image behind the map."""
    image, (left, right, bottom, top) = background_image(background, low, high, least)
    _, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return {
        "source": "data:image/png;base64," + base64.b64encode(png.tobytes()).decode(),
        "xref": "x",
        "yref": "y",
        "x": left,
        "y": top,
        "sizex": right - left,
        "sizey": top - bottom,
        "sizing": "stretch",
        "layer": "below",
    }


def background_image(
    background: SparseGrid, low: F64, high: F64, least: float
) -> tuple[U8, tuple[float, float, float, float]]:
    """Standing surroundings of the part of the map from `low` to `high`, x and y in metres.

    Args:
        background: Where points lie.
        low: (2,) lower left of what is shown.
        high: (2,) upper right.
        least: Share of the most frequent cells below which nothing is drawn.

    Returns:
        (H, W, 4) image, red first: grey, the more opaque the more often points were there; and where its left, right,
        bottom and top are, metres.
    """
    low, high = low - 0.5 * (high - low), high + 0.5 * (high - low)
    cell_m = max(background.cell_m, float((high - low).max()) / MAX_PIXELS)
    width, height = np.maximum(np.ceil((high - low) / cell_m), 1).astype(int).tolist()
    centers, counts = background.centers, background.counts
    columns = np.floor((centers - low) / cell_m).astype(np.intp)
    inside = ((columns >= 0) & (columns < [width, height])).all(1)
    weights = np.zeros((height, width))
    np.maximum.at(weights, (height - 1 - columns[inside, 1], columns[inside, 0]), counts[inside])
    some = weights[weights > 0]
    full = max(float(np.percentile(some, 90)), 2.0) if len(some) else 1.0
    image = np.full((height, width, 4), 128, np.uint8)
    image[..., 3] = (200 * np.sqrt(np.minimum(weights / full, 1.0))).astype(np.uint8)
    image[weights <= least * full, 3] = 0
    left, bottom = float(low[0]), float(low[1])
    return image, (left, left + width * cell_m, bottom, bottom + height * cell_m)


def _zones(rig: Rig, low: F64, high: F64) -> list[Figure]:
    """The counted zones as far as they lie in view, each with its name."""
    traces = []
    for zone in rig.counted_zones:
        corners = clipped_polygon(zone.polygon_site, low - 0.05 * (high - low), high + 0.05 * (high - low))
        shown = clipped_polygon(zone.polygon_site, low, high)
        if not len(shown):
            continue
        x, y = np.concatenate([corners, corners[:1]]).T
        hidden = {"hoverinfo": "skip", "showlegend": False}
        line = {"color": "@faint", "width": 1.5, "dash": "dash"}
        traces.append(trace("lines", zone.name, (x, y), line=line, **hidden))
        x, y = (shown.min(0) + shown.max(0))[:, None] / 2
        font = {"color": "@faint", "size": 13}
        traces.append(trace("text", zone.name, (x, y), text=[zone.name], textfont=font, **hidden))
    return traces


def _way(seen: ReportCollector) -> list[Figure]:
    if not seen.travelled_m:
        return []
    ((_, line),) = seen.way.lines()
    look = {"color": "@ink", "width": 1.5, "dash": "dot"}
    return [trace("lines", "path of the sensors", (line[:, 0], line[:, 1]), line=look, hoverinfo="name")]


def _dots(grid: SparseGrid, name: str, class_id: int) -> Figure:
    x, y = grid.centers.T
    hover = f"%{{x:.1f}}, %{{y:.1f}} m<extra>{name}</extra>"
    return trace("markers", name, (x, y), marker={"color": f"@class:{class_id}", "size": 4}, hovertemplate=hover)


def _line(name: str, color: str, lines: Sequence[F64], view: str) -> Figure:
    """Lines one after another, with a gap behind each."""
    x, y, speeds, seconds = np.concatenate([part for line in lines for part in (line, np.full((1, 4), np.nan))]).T
    return trace(
        "lines",
        name,
        (x, y),
        legendgroup=name,
        meta=view,
        customdata=rounded(np.round(np.stack([KM_H * speeds, seconds], 1), 1)),
        line={"color": color, "width": 2},
        connectgaps=False,
        hovertemplate="%{x:.1f}, %{y:.1f} m<br>%{customdata[0]} km/h at %{customdata[1]} s" + f"<extra>{name}</extra>",
    )


def _ends(name: str, color: str, lines: Sequence[F64], view: str) -> Figure:
    """Dots where tracks were last."""
    x, y = np.array([line[-1, :2] for line in lines[:500]]).T
    hidden = {"hoverinfo": "skip", "showlegend": False}
    return trace("markers", name, (x, y), legendgroup=name, meta=view, marker={"color": color, "size": 6}, **hidden)


def _by_speed(lines: Sequence[F64]) -> list[Figure]:
    """The lines once more, in pieces of the same step of speed."""
    fastest = KM_H * float(np.concatenate(lines)[:, 2].max(initial=0.0))
    step = nice(max(fastest, 0.1) / SPEED_STEPS)
    pieces: dict[int, list[F64]] = {}
    for line in lines:
        steps = np.minimum(KM_H * line[:-1, 2] // step, SPEED_STEPS + 1).astype(int)
        cuts = np.flatnonzero(np.diff(steps)) + 1
        for first, last in zip([0, *cuts.tolist()], [*cuts.tolist(), len(steps)], strict=True):
            if last > first:
                pieces.setdefault(int(steps[first]), []).append(line[first : last + 1])
    count = max(pieces, default=0)
    return [
        _line(f"{row * step:.3g} to {(row + 1) * step:.3g} km/h", f"@speed:{row / max(count, 1):.3f}", own, "by speed")
        for row, own in sorted(pieces.items())
    ]
