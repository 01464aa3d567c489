"""The plots of a page that need truth: precision over recall, errors by place."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.evaluation.detection.plots import DetectionPlots
from lidcam.writers.report.values import Figure, axis, nice, per, rounded, trace

MAX_CELLS = 40
"""Maximum number of cells along a side of the map of errors."""


def curves_figure(plots: DetectionPlots, class_names: Sequence[str]) -> Figure:
    """Precision over recall of each source, class by class."""
    traces, truth = [], {}
    for class_id, name in enumerate(class_names):
        for source, counts in plots.truth_counts.items():
            scores, recall, precision = plots.curve(source, class_id)
            if len(scores):
                truth[name] = int(counts[class_id])
                shown = {
                    "meta": name,
                    "customdata": rounded(scores),
                    "line": {"color": f"@source:{source}", "width": 2.5 if source == "fused" else 1.5},
                    "hovertemplate": "precision %{y:.2f}, recall %{x:.2f}<br>score %{customdata:.2f} and more"
                    f"<extra>{source}</extra>",
                }
                traces.append(trace("lines", source, (recall, precision), **shown))
    whole = {"range": [0, 1.02], "constrain": "domain"}
    layout = {"xaxis": axis("recall", **whole), "yaxis": axis("precision", **whole)}
    views = sorted(truth, key=lambda name: -truth[name])
    return {"data": traces, "layout": layout, "views": views, "height": 340}


def error_map(plots: DetectionPlots) -> Figure | None:
    """A map of true objects that are placed wrongly or missed; None without any."""
    places = plots.places
    if not len(places.errors_m):
        return None
    low, high = np.percentile(places.xy, [1, 99], axis=0)
    cell_m = nice(max(float((high - low).max()), 1.0) / MAX_CELLS)
    corner = np.floor(low / cell_m)
    width, height = (np.floor(high / cell_m) - corner + 1).astype(int).tolist()
    cells = (np.floor(places.xy / cell_m) - corner).astype(np.intp)
    inside = ((cells >= 0) & (cells < [width, height])).all(1)
    keys, errors = (cells[:, 1] * width + cells[:, 0])[inside], places.errors_m[inside]
    is_found = ~np.isnan(errors)
    total = np.bincount(keys, minlength=width * height)
    found = np.bincount(keys[is_found], minlength=width * height)
    mean = per(np.bincount(keys[is_found], errors[is_found], width * height), found)
    missed = np.where(total > 0, 1 - per(found, total), np.nan)
    shape = height, width
    common = {
        "type": "heatmap",
        "x": rounded((corner[0] + np.arange(width + 1)) * cell_m),  # edges
        "y": rounded((corner[1] + np.arange(height + 1)) * cell_m),
        "customdata": total.reshape(shape).tolist(),
        "colorscale": [[0, "@calm"], [0.5, "@warn"], [1, "@bad"]],
    }
    position_error = {
        "meta": "position error",
        "z": rounded(mean.reshape(shape)),
        "zmin": 0,
        "zmax": round(float(np.nanpercentile(mean, 95)), 3) if found.any() else 1,
        "colorbar": {"title": {"text": "m"}, "thickness": 10},
        "hovertemplate": "%{z:.2f} m off in the mean<br>%{customdata} true boxes<extra></extra>",
    }
    share_missed = {
        "meta": "share missed",
        "z": rounded(missed.reshape(shape)),
        "zmin": 0,
        "zmax": 1,
        "colorbar": {"thickness": 10, "tickformat": ".0%"},
        "hovertemplate": "%{z:.0%} missed<br>%{customdata} true boxes<extra></extra>",
    }
    views = [position_error] * bool(found.any()) + [share_missed]
    layout = {"xaxis": axis("x, m", constrain="domain"), "yaxis": axis("y, m", scaleanchor="x", constrain="domain")}
    names = [view["meta"] for view in views]
    return {"data": [common | view for view in views], "layout": layout, "views": names, "height": 380}
