"""What is drawn at a path of a recording is logged where there is something, or was."""

from collections.abc import Iterable


class News:
    """Remembers at which paths nothing is drawn; at `empty` ones, nothing is at first."""

    def __init__(self, empty: Iterable[str] = ()) -> None:
        self._empty = set(empty)

    def at(self, path: str, count: int) -> bool:
        """Whether so many things at a path are to be logged: not where there are none, and there were none."""
        if count == 0 and path in self._empty:
            return False
        (self._empty.discard if count else self._empty.add)(path)
        return True

    def cleared(self, path: str) -> None:
        """Take note that nothing is drawn at a path any more."""
        self._empty.add(path)
