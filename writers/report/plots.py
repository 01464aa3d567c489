"""The plots of a page that need no truth: over time, of speeds, of stays."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.evaluation.road_users import RoadUserTable
from lidcam.writers.report.collector import ReportCollector, Timeline
from lidcam.writers.report.values import KM_H, Figure, axis, nice, per, rounded, seconds_axis, trace


def objects_figure(seen: ReportCollector, class_names: Sequence[str], places: Sequence[str]) -> Figure:
    """How many objects of each class there were at a time: of all, and in each zone."""
    counts = seen.time.counts()
    traces, views = [], ["everywhere", *[place for place in places if place]] if len(places) > 1 else []
    for view in views or ["everywhere"]:
        for class_id, name in enumerate(class_names):
            own = [seen.time.sums(f"{name} {place}") for place in places if view in ("everywhere", place)]
            total = np.sum(own, 0)
            if total.any():
                stairs = _stairs(name, seen.time, per(total, counts), f"@class:{class_id}", 2, "%{y:.1f}", name)
                traces.append(stairs | ({"meta": view} if views else {}))
    layout = {"xaxis": seconds_axis(), "yaxis": axis("objects at a time", rangemode="tozero")}
    return {"data": traces, "layout": layout, "views": views, "height": 260}


def _stairs(name: str, time: Timeline, values: F64, color: str, width: float, hover: str, extra: str = "") -> Figure:
    """The values (S,) of the steps of time as a line of stairs, up to the end of the last step."""
    return trace(
        "lines",
        name,
        (time.edges_s, np.append(values, values[-1])),
        line={"color": color, "width": width, "shape": "hv"},
        hovertemplate=f"{hover} at %{{x:.1f}} s<extra>{extra}</extra>",
    )


def sensors_figure(seen: ReportCollector, rig: Rig) -> Figure:
    """Whether each sensor was there, by step of time: its rate as a share of what it mostly is, but for a message.

    Topics that no frame was to have, such as images that are not written, are left out.
    """
    time = seen.sensors
    counts, left_s = time.counts(), np.maximum(seen.seconds - time.edges_s[:-1], 1e-3)
    whole_s = np.minimum(time.step_s, left_s + seen.seconds / max(seen.frames, 1))
    used = [
        (topic, name) for topic, name in rig.sensor_of_topic.items() if time.sums(topic).any() or name in seen.missed
    ]
    names, counted = [name for _, name in used[::-1]], [time.sums(topic) for topic, _ in used[::-1]]
    rates = [count / whole_s for count in counted]
    usual = [float(np.percentile(rate, 75)) * whole_s for rate in rates]  # messages in each step, mostly
    shares = [
        np.where(is_known, np.minimum((count + (count > 0)) / np.maximum(expected, 1), 1), np.nan)
        for count, expected in zip(counted, usual, strict=True)
        for is_known in [(expected >= 1) | (count > 0) | (not count.any())]
    ]
    rows = {
        "type": "heatmap",
        "x": rounded(time.edges_s),
        "y": names,
        "z": [rounded(np.where(counts > 0, share, np.nan)) for share in shares],
        "customdata": [rounded(rate) for rate in rates],
        "zmin": 0,
        "zmax": 1,
        "showscale": False,
        "xgap": 0,
        "ygap": 3,
        "colorscale": [[0, "@bad"], [0.001, "@warn"], [0.5, "@warn"], [0.75, "@calm"], [1, "@calm"]],
        "hovertemplate": "%{y}: %{customdata:.1f} Hz at %{x:.1f} s<extra></extra>",
    }
    layout = {"xaxis": seconds_axis(), "yaxis": {"automargin": True, "ticklen": 0, "tickfont": {"size": 11}}}
    return {"data": [rows], "layout": layout, "height": 70 + 20 * len(names)}


def skew_figure(seen: ReportCollector) -> Figure:
    """The largest difference of stamps in a frame, by step of time."""
    skew_ms = np.where(seen.time.counts() > 0, seen.time.largest(), np.nan)
    stairs = _stairs("skew", seen.time, skew_ms, "@ink", 1.5, "%{y:.1f} ms")
    layout = {"xaxis": seconds_axis(), "yaxis": axis("skew, ms", rangemode="tozero"), "showlegend": False}
    return {"data": [stairs], "layout": layout, "height": 180}


def speeds_figure(users: RoadUserTable, class_names: Sequence[str]) -> Figure:
    """Road users that moved by their mean speed."""
    speeds = KM_H * users.speed_means
    fastest = float(speeds[users.moved].max(initial=0.1))
    step = nice(max(fastest, 0.1) / 12)
    edges = np.arange(0, fastest + step, step)
    edges = np.append(edges, edges[-1] + step)
    most = np.histogram(speeds[users.moved], edges)[0].max()
    traces = []
    for class_id, name in enumerate(class_names):
        own = speeds[users.moved & (users.class_ids == class_id)]
        if len(own):
            traces.append(
                {
                    "type": "bar",
                    "name": name,
                    "x": rounded((edges[:-1] + edges[1:]) / 2),
                    "y": np.histogram(own, edges)[0].tolist(),
                    "marker": {"color": f"@class:{class_id}"},
                    "width": step * 0.9,
                    "hovertemplate": "%{y} at %{x} &#177; " + f"{step / 2:.3g} km/h<extra>{name}</extra>",
                }
            )
    layout = {
        "barmode": "stack",
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "traceorder": "normal"},
        "xaxis": axis("mean speed of each, km/h", rangemode="tozero"),
        "yaxis": axis("road users", dtick=max(nice(most / 5), 1.0)),
    }
    return {"data": traces, "layout": layout, "height": 240}


def dwell_figure(users: RoadUserTable, class_names: Sequence[str]) -> Figure:
    """How long road users stay in each zone, or in view where there are none."""
    columns = [*range(1, len(users.places)), 0] if len(users.places) > 1 else [0]
    traces = []
    for class_id, name in enumerate(class_names):
        own = [
            (users.places[c] or "in view", users.seconds[(users.class_ids == class_id) & (users.frames[:, c] > 0), c])
            for c in columns
        ]
        own = [(place, seconds) for place, seconds in own if len(seconds)]
        if own:
            shares = rounded(np.array([np.percentile(s, [0, 25, 50, 75, 100]) for _, s in own]).T)
            box = {"type": "box", "name": name, "orientation": "h", "y": [place for place, _ in own]}
            box |= zip(("lowerfence", "q1", "median", "q3", "upperfence"), shares, strict=True)
            traces.append({**box, "marker": {"color": f"@class:{class_id}"}, "line": {"width": 1.5}})
    layout = {
        "boxmode": "group",
        "xaxis": axis("time there, s", rangemode="tozero"),
        "yaxis": {"automargin": True, "autorange": "reversed"},
    }
    return {"data": traces, "layout": layout, "height": 130 + 26 * sum(len(trace["y"]) for trace in traces)}
