"""The tables that are printed."""

from collections.abc import Iterable, Mapping, Sequence
from math import isnan
from typing import Any

from rich.cells import cell_len
from rich.console import RenderableType
from rich.style import StyleType
from rich.table import Table

from lidcam.cli.printing.terminal import Folded
from lidcam.pipeline.core.rig import BOXES_SUFFIX
from lidcam.pipeline.core.settings.model import OUTSIDE_ZONES
from lidcam.pipeline.evaluation.road_users import RoadUsers
from lidcam.readers.rig.calibration import SensorSource
from lidcam.readers.streams.survey import TopicSurvey
from lidcam.run.missing import MissingSensor
from lidcam.run.summary import DropCount


class ColumnsTable(Table):
    """A table of texts (the first column, and `text_columns`) and numbers, with a title.

    Texts and headings are folded where they must be; numbers never are.
    """

    def __init__(self, title: str, first: str, *columns: str, text_columns: Sequence[str] = ()) -> None:
        super().__init__(
            title=title, title_justify="left", title_style="bold", header_style="dim", box=None, pad_edge=False
        )
        for column in (first, *columns):
            self.add_column(Folded(column), justify="left" if column in {first, *text_columns} else "right")

    def add_row(
        self, *renderables: RenderableType | None, style: StyleType | None = None, end_section: bool = False
    ) -> None:
        """Add the cells of a row."""
        cells = list(renderables)
        for n, (cell, column) in enumerate(zip(cells, self.columns, strict=False)):
            if isinstance(cell, str):
                if column.justify == "left":
                    cells[n] = Folded(cell)
                else:
                    column.min_width = max(column.min_width or 0, cell_len(cell))
        super().add_row(*cells, style=style, end_section=end_section)


def rows_table(
    title: str, columns: Sequence[str], rows: Iterable[Iterable[object]], text_columns: Sequence[str] = ()
) -> Table:
    """A table of rows of values."""
    table = ColumnsTable(title, *columns, text_columns=text_columns)
    for row in rows:
        table.add_row(*map(str, row))
    return table


def pairs_table(title: str, pairs: Mapping[str, Any]) -> Table:
    """Names and values, without a header."""
    table = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    table.add_column(no_wrap=True)
    for name, value in pairs.items():
        table.add_row(name, Folded(str(value)))
    return table


def objects_table(objects: Mapping[tuple[str, str], int], zones: Sequence[str], frames: int) -> Table:
    """Fused objects by class (rows) and zone (columns), in total and per frame; without a title."""
    places = [*zones, OUTSIDE_ZONES] if zones else []
    rows = []
    for name in sorted({name for name, _ in objects}):
        count = sum(found for (known, _), found in objects.items() if known == name)
        rows.append(
            [name, *(objects.get((name, place), 0) for place in places), count, f"{count / max(frames, 1):.1f}"]
        )
    return rows_table("", ["class", *places, "all", "per frame"], rows or [["none", *(0 for _ in places), 0, "0.0"]])


def road_users_table(users: RoadUsers, zones: Sequence[str]) -> Table:
    """Road users, and how fast those went that moved, by class and, with zones, by zone and over the whole site."""
    names = ("class", "zone") if zones else ("class",)
    rows: list[list[object]] = []
    last = ""
    for one in users.counts:
        name, last = "" if one.class_name == last else one.class_name, one.class_name
        speeds = speed_text(one.speed_mean_m_s), speed_text(one.speed_max_m_s)
        rows.append([name, *([one.zone or "all"] if zones else []), one.count, one.moved, *speeds])
    rows = rows or [["none", *([""] if zones else []), 0, 0]]
    return rows_table("road users", [*names, "number", "moved", "mean m/s", "max m/s"], rows, names)


def speed_text(speed_m_s: float) -> str:
    """A speed, m/s; empty where it is not known."""
    return "" if isnan(speed_m_s) else f"{speed_m_s:.1f}"


def drops_table(used: Mapping[str, int], drops: Sequence[DropCount]) -> Table:
    """Messages by topic: used, and dropped by reason."""
    rows: list[list[object]] = []
    for topic in sorted({*used, *(drop.topic for drop in drops)}):
        names: list[object] = [topic, used.get(topic, 0)]
        reasons = [(str(drop.count), drop.reason) for drop in drops if drop.topic == topic]
        for count, reason in reasons or [("", "")]:
            rows.append([*names, count, reason])
            names = ["", ""]
    return rows_table("messages", ["topic", "used", "dropped", "reason"], rows, ("reason",))


def missing_table(sensors: Sequence[MissingSensor]) -> Table:
    """Sensors missing from frames. A camera and its boxes share a row where they agree."""
    cells = {sensor.sensor: (sensor.frames, str(sensor)) for sensor in sensors}
    rows = []
    for name, row in cells.items():
        if cells.get(f"{name}{BOXES_SUFFIX}") == row:
            rows.append((f"{name} and its boxes", *row))
        elif not name.endswith(BOXES_SUFFIX) or cells.get(name.removesuffix(BOXES_SUFFIX)) != row:
            rows.append((name, *row))
    return rows_table("missing from frames", ("sensor", "frames", "when"), rows, ("when",))


def topics_table(topics: Sequence[TopicSurvey]) -> Table:
    """The topics of a recording."""
    columns = ("topic", "type", "count", "Hz", "gaps", "longest", "delay", "")
    rows = (
        (
            topic.topic,
            topic.msgtype.replace("/msg/", "/"),
            topic.count,
            f"{topic.rate_hz:.1f}" if topic.rate_hz else "",
            topic.gaps or "",
            f"{topic.longest_gap_s:.3f} s" if topic.longest_gap_s else "",
            f"{1e3 * topic.delay_s:.1f} ms" if topic.count else "",
            ", ".join(
                filter(None, (topic.problem, f"{topic.backwards} stamps run backwards" if topic.backwards else ""))
            ),
        )
        for topic in topics
    )
    return rows_table("topics", columns, rows, ("type", ""))


def sensors_table(sensors: Sequence[SensorSource]) -> Table:
    """The sensors in use, and where their calibration comes from."""
    columns = ["sensor", "topic", "frame_id", "intrinsics", "extrinsics"]
    offsets = [f"{sensor.time_offset_ms:g} ms" if sensor.time_offset_ms else "" for sensor in sensors]
    shown = ["time offset"] if any(offsets) else []
    rows = (
        [*(getattr(sensor, column) for column in columns), *([offset] if shown else [])]
        for sensor, offset in zip(sensors, offsets, strict=True)
    )
    return rows_table("sensors", [*columns, *shown], rows, columns)
