"""Notes for the user about what was read: one line for each kind, with how often it was met."""

from dataclasses import dataclass, field

MAX_KINDS = 100
"""Kinds of notes that are counted separately: their texts may contain names from a file."""


@dataclass(slots=True)
class Notes:
    """Counts by what is noted, with the details of the first time."""

    _counts: dict[str, int] = field(default_factory=dict)
    _details: dict[str, str] = field(default_factory=dict)

    def add_note(self, what: str, detail: str = "", count: int = 1) -> None:
        """Note something; of many kinds, those beyond `MAX_KINDS` are counted together."""
        if what not in self._counts and len(self._counts) >= MAX_KINDS:
            what, detail = "others", ""
        self._counts[what] = self._counts.get(what, 0) + count
        self._details.setdefault(what, detail)

    def lines(self) -> tuple[str, ...]:
        """The notes, in the order of their first time."""
        return tuple(
            f"{what}: {count}" + (f", the first: {detail}" if (detail := self._details[what]) else "")
            for what, count in self._counts.items()
        )
