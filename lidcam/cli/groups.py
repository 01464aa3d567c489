"""How commands are looked up and how their help is laid out."""

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

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, then each group of options."""
        groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                is_argument = parameter.param_type_name == "argument"
                group = "Arguments" if is_argument else getattr(parameter, "rich_help_panel", None) or OTHERS
                groups[group].append(record)
        for group in sorted(groups, key=lambda name: name == OTHERS):
            with formatter.section(group):
                formatter.write_dl(groups[group])
