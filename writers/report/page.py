"""The page as one file: content, style, plots and the script that draws them. Nothing is fetched when it is opened."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

from markupsafe import Markup, escape

from lidcam.pipeline.core.text import visible
from lidcam.writers.outputs.marks import PAGE
from lidcam.writers.palette import Rgb, class_color
from lidcam.writers.report.values import Figure

_BACKTICKS = re.compile(r"`([^`]+)`")

CLASSES = 6
"""Colours of classes; they repeat after these."""

LIGHT_SHARE = 0.72
"""Brightness of a class's colour on a light ground, as a share of that on a dark one, for which it was chosen."""

_SHARES = {"light": LIGHT_SHARE, "dark": 1.0}
_SPEEDS = {
    "light": ("#2c3f8f", "#2a6f97", "#2a9d8f", "#8ab17d", "#e9a227", "#e76f2c", "#c1121f"),
    "dark": ("#5b7fd6", "#4aa3cf", "#45c4b0", "#a9d18e", "#f4c95d", "#f78c4a", "#ff5a5f"),
}
_NAMES = ("ink", "line", "faint", "bad", "warn", "calm", "source:lidar", "source:cameras", "source:fused")
_THEMES = {
    "light": ("#1d2126", "#e3e6e9", "#7a848d", "#c1121f", "#eba43a", "#b9d5dd", "#2a6f97", "#c77700", "#1c7a4b"),
    "dark": ("#e6e9ec", "#2c3238", "#88929b", "#ff5a5f", "#d99a3d", "#2f5661", "#56b4e9", "#f4a84a", "#4fd693"),
}
"""The colours of `_NAMES`."""


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table of a page: cells are text, or HTML that is `Markup`."""

    head: Sequence[str]  # Names of the columns
    rows: Sequence[Sequence[object]]  # The cells; without rows there is no table
    words: Sequence[int] = (0,)  # Columns of words, which stand left; numbers stand right
    title: str = ""  # Its heading
    notes: Sequence[str] = ()  # Lines below it


def page(figures: Mapping[str, Figure], **content: object) -> str:
    """The whole page: the template with its content, and the plots by name."""
    return _rendered(
        "page.html",
        figures=figures,
        figures_json=_json({name: {"views": [], **figure} for name, figure in figures.items()}),
        palette=_json({theme: _colors(theme) for theme in _THEMES}),
        plotly=Markup(_text("plotly-cartesian.min.js").replace("</script", "<\\/script")),
        script=Markup(_text("page.js")),
        **content,
    )


def index_page(rows: Sequence[Mapping[str, object]], totals: str) -> str:
    """A page with a row for each of many results.

    Args:
        rows: `name`, `state`, `message`, `frames`, `users`, `dropped`, `links` (name and URL of each), and `thumbnail`,
            the URL of an image or empty.
        totals: A line about all of them.
    """
    return _rendered("index.html", title="lidcam: recordings", rows=rows, totals=totals)


def _rendered(name: str, **content: object) -> str:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        finalize=lambda value: visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value,
    )
    environment.filters |= {"prose": prose, "sentence": lambda text: text[:1].upper() + text[1:]}
    style = Markup(_text("page.css") + _swatches())
    return environment.from_string(_text(name)).render(mark=Markup(PAGE), style=style, **content)


def class_name(class_id: int, name: str) -> Markup:
    """The name of a class behind a square of its colour."""
    swatch = Markup('<span class="name"><span class="swatch c{}"></span>{}</span>')
    return swatch.format(class_id % CLASSES, visible(name))


def prose(value: object) -> object:
    """A text whose words between backticks are in the font of code; anything else as it is."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return Markup(_BACKTICKS.sub(r"<code>\1</code>", str(escape(visible(value)))))


def _text(name: str) -> str:
    return files("lidcam.writers.report").joinpath(name).read_text(encoding="utf-8")


def _json(tree: object) -> Markup:
    return Markup(json.dumps(tree, separators=(",", ":"), ensure_ascii=True).replace("<", "\\u003c"))


def _colors(theme: str) -> dict[str, object]:
    named = dict(zip(_NAMES, _THEMES[theme], strict=True))
    classes = {f"class:{row}": _hex(class_color(row), _SHARES[theme]) for row in range(64)}
    shown = {f"@{name}": color for name, color in (named | classes).items()}
    return {**shown, "line": named["line"], "ink": named["ink"], "speeds": _SPEEDS[theme]}


def _swatches() -> str:
    light, dark = (
        "".join(f".c{row}{{background:{_hex(class_color(row), share)}}}" for row in range(CLASSES))
        for share in _SHARES.values()
    )
    return f"{light}@media (prefers-color-scheme: dark){{{dark}}}"


def _hex(color: Rgb, share: float) -> str:
    return "#" + "".join(f"{round(255 * share * part):02x}" for part in color)
