"""The tables that are printed, one function each."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.cells import cell_len
from rich.console import RenderableType
from rich.style import StyleType
from rich.table import Table

from lidcam.cli.printing.folding import Folded
from lidcam.pipeline.core.rig import BOXES_SUFFIX, OUTSIDE_ZONES
from lidcam.pipeline.evaluation.road_users import RoadUsers, ZoneChange
from lidcam.readers.rig.calibration import SensorSource
from lidcam.readers.streams.survey import TopicSurvey
from lidcam.run.missing import MissingSensor
from lidcam.run.summary import DropCount


def objects_table(objects: Mapping[tuple[str, str], int], zones: Sequence[str], frames: int) -> Table:
    """Fused objects by class (rows), summed over the frames and a frame; with zones, by zone (columns) too.

    Without a title, which would be broken to the width of its columns.
    """
    places = [*zones, OUTSIDE_ZONES] if zones else []
    table = ColumnsTable("", "class", *places, "all", "a frame")
    classes = sorted({name for name, _ in objects})
    for name in classes:
        count = sum(found for (known, _), found in objects.items() if known == name)
        in_places = (str(objects.get((name, place), 0)) for place in places)
        table.add_row(name, *in_places, str(count), f"{count / max(frames, 1):.1f}")
    if not classes:
        table.add_row("none", *("0" for _ in places), "0", "0.0")
    return table


def road_users_table(users: RoadUsers, zones: Sequence[str]) -> Table:
    """How many road users there were, and how fast, by class; with zones, by zone too, and in all of the site."""
    text_columns = ("class", "zone") if zones else ("class",)
    table = ColumnsTable("road users", *text_columns, "number", "mean m/s", "max m/s", text_columns=text_columns)
    last = ""
    for one in users.counts:
        place = [one.zone or "all"] if zones else []
        name, last = "" if one.class_name == last else one.class_name, one.class_name
        table.add_row(name, *place, str(one.count), f"{one.speed_mean_m_s:.1f}", f"{one.speed_max_m_s:.1f}")
    if not users.counts:
        table.add_row("none", *[""] * bool(zones), "0")
    return table


def changes_table(changes: Sequence[ZoneChange]) -> Table:
    """Which road users went from zone to zone."""
    text_columns = ("class", "from", "to")
    table = ColumnsTable("road users from zone to zone", *text_columns, "number", "mean m/s", text_columns=text_columns)
    for one in changes:
        table.add_row(one.class_name, one.from_zone, one.to_zone, str(one.count), f"{one.speed_mean_m_s:.1f}")
    return table


def drops_table(used: Mapping[str, int], drops: Sequence[DropCount]) -> Table:
    """Messages by topic: how many were used, how many were dropped and why."""
    table = ColumnsTable("messages", "topic", "used", "dropped", "reason", text_columns=("topic", "reason"))
    for topic in sorted({*used, *(drop.topic for drop in drops)}):
        reasons = [(drop.reason, drop.count) for drop in drops if drop.topic == topic]
        total = str(used.get(topic, 0))
        for row, (reason, count) in enumerate(reasons or [("", 0)]):
            table.add_row(topic if row == 0 else "", total if row == 0 else "", str(count or ""), reason)
    return table


def losses_table(losses: Sequence[Mapping[str, Any]]) -> Table:
    """Damaged parts of the files: where, how much, how many messages, and why."""
    table = ColumnsTable("damage", "file", "from byte", "bytes", "messages lost", "reason", text_columns=("reason",))
    for loss in losses:
        size, messages = ("unknown" if loss[key] is None else str(loss[key]) for key in ("size", "messages"))
        table.add_row(loss["file"], str(loss["position"]), size, messages, loss["reason"])
    return table


def missing_table(sensors: Sequence[MissingSensor]) -> Table:
    """Sensors missing from frames: from how many, and when. A camera and its boxes share a row where they agree."""
    table = ColumnsTable("missing from frames", "sensor", "frames", "when", text_columns=("when",))
    cells = {sensor.sensor: (str(sensor.frames), str(sensor)) for sensor in sensors}
    for name, row in cells.items():
        if cells.get(f"{name}{BOXES_SUFFIX}") == row:
            table.add_row(f"{name} and its boxes", *row)
        elif not name.endswith(BOXES_SUFFIX) or cells.get(name.removesuffix(BOXES_SUFFIX)) != row:
            table.add_row(name, *row)
    return table


def stages_table(seconds: Mapping[str, float], frames: int) -> Table:
    """Milliseconds a frame in each stage; without those that would be shown as 0.0."""
    table = ColumnsTable("time", "stage", "ms a frame")
    for name, spent in seconds.items():
        if (milliseconds := f"{1e3 * spent / max(frames, 1):.1f}") != "0.0":
            table.add_row(name, milliseconds)
    return table


def points_table(points: Mapping[str, int], frames: int) -> Table:
    """Lidar points a frame by step of the combination."""
    table = ColumnsTable("points", "step", "points a frame")
    for step, count in points.items():
        table.add_row(step, f"{count / max(frames, 1):.0f}")
    return table


def pairs_table(title: str, pairs: Mapping[str, Any]) -> Table:
    """Names and values, without a header."""
    table = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    table.add_column(no_wrap=True)
    for name, value in pairs.items():
        table.add_row(name, Folded(str(value)))
    return table


def topics_table(topics: Sequence[TopicSurvey]) -> Table:
    """The topics of a recording, one per row."""
    columns = ("type", "count", "Hz", "gaps", "longest", "delay", "")
    table = ColumnsTable("topics", "topic", *columns, text_columns=("type", ""))
    for topic in topics:
        remarks = [topic.problem] if topic.problem else []
        if topic.backwards:
            remarks.append(f"{topic.backwards} stamps run backwards")
        table.add_row(
            topic.topic,
            topic.msgtype.replace("/msg/", "/"),
            str(topic.count),
            f"{topic.rate_hz:.1f}" if topic.rate_hz else "",
            str(topic.gaps or ""),
            f"{topic.longest_gap_s:.3f} s" if topic.longest_gap_s else "",
            f"{1e3 * topic.delay_s:.1f} ms" if topic.count else "",
            ", ".join(remarks),
        )
    return table


def sensors_table(sensors: Sequence[SensorSource]) -> Table:
    """The sensors that are used, and where their calibration comes from."""
    columns = ("sensor", "topic", "frame_id", "intrinsics", "extrinsics")
    is_shifted = any(sensor.time_offset_ms for sensor in sensors)
    table = ColumnsTable("sensors", *columns, *["time offset"] * is_shifted, text_columns=columns)
    for sensor in sensors:
        offset = f"{sensor.time_offset_ms:g} ms" if sensor.time_offset_ms else ""
        table.add_row(*(getattr(sensor, column) for column in columns), *[offset] * is_shifted)
    return table


class ColumnsTable(Table):
    """A table of texts (the first column, and `text_columns`) and numbers, with a title.

    Texts, and names above columns, are folded where they must be; numbers never are.
    """

    def __init__(self, title: str, first: str, *columns: str, text_columns: tuple[str, ...] = ()) -> None:
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
