"""How commands are looked up and how their help is laid out."""

import re
from collections import defaultdict
from pathlib import Path
from typing import Any

from typer.core import TyperCommand, TyperGroup

OTHERS = "Options"
"""Heading of the options that belong to no group."""


class Program(TyperGroup):
    """The commands of lidcam; a recording in place of a command is processed."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command of a name; `lidcam drive.bag` is `lidcam process drive.bag`."""
        word = args[0]
        if word not in self.commands and (set("./\\") & set(word) or Path(word).exists()):
            args = ["process", *args]
        return super().resolve_command(ctx, args)


class GroupedCommand(TyperCommand):
    """A command whose help lists its options by group, in the order in which the groups first occur."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The parts of the usage line; arguments as they are called, without braces."""
        return [re.sub(r"^\{(.*)\}(\.\.\.)?$", r"\1", piece) for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, then each group of options."""
        groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            if parameter.param_type_name == "argument":
                name, text = record
                groups["Arguments"].append((name.partition(" <")[0], text))
            else:
                groups[getattr(parameter, "rich_help_panel", None) or OTHERS].append(record)
        for group in sorted(groups, key=lambda name: name == OTHERS):
            with formatter.section(group):
                formatter.write_dl(groups[group])
