"""Numbers of plots, and the trees that plotly draws: plain ones, without its Python side.

Colours are names that the page's script looks up by theme: `@class:2`, `@ink`, `@bad`. A trace with a `meta` is drawn
in the view of that name alone; `views` are those that a figure offers, the first is shown.
"""

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64

KM_H = 3.6
"""Speed of one metre per second, km/h."""

Figure: TypeAlias = dict[str, Any]
Numbers: TypeAlias = npt.NDArray[np.integer] | npt.NDArray[np.floating]


def trace(mode: str, name: str, xy: tuple[Numbers, Numbers], **others: Any) -> Figure:
    """A trace through or at points: `lines`, `markers` or `text`."""
    return {"type": "scatter", "mode": mode, "name": name, "x": rounded(xy[0]), "y": rounded(xy[1]), **others}


def axis(title: str, **others: Any) -> Figure:
    """An axis with a title."""
    return {"title": {"text": title}, **others}


def seconds_axis() -> Figure:
    """The axis of time."""
    return axis("seconds since the first frame", rangemode="tozero")


def per(sums: Numbers, counts: Numbers) -> F64:
    """Sums by counts; NaN where there is nothing to count."""
    found: F64 = np.divide(sums, counts, out=np.full(np.shape(sums), np.nan), where=np.asarray(counts) > 0)
    return found


def nice(step: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(next(power * one for one in (1, 2, 5, 10) if power * one >= step * 0.999))


def rounded(values: Numbers) -> list[Any]:
    """Nested lists of numbers to the thousandth, with None for what is no number."""
    exact = np.round(values.astype(np.float64), 3)
    found = exact.astype(object)
    found[~np.isfinite(exact)] = None
    return list(found.tolist())
