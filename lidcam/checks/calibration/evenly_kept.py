"""A few items of a long run, spread over all of it."""

from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class EvenlyKept(Generic[T]):
    """Keeps at most so many items: whenever there are more, every second one is discarded."""

    def __init__(self, max_items: int) -> None:
        self._max_items, self._items = max_items, list[T]()
        self._seen, self._stride = 0, 1

    def add(self, item: T) -> None:
        """Take one more item; whether it is kept depends on its number alone."""
        if self._seen % self._stride == 0:
            self._items.append(item)
            if len(self._items) > self._max_items:
                self._items, self._stride = self._items[::2], 2 * self._stride
        self._seen += 1

    def __iter__(self) -> Iterator[T]:
        return iter(self._items)
