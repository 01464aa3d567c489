"""A console that prints text as it is, to terminals, pipes and files."""

import os

from rich.console import Console

__all__ = ["console"]


class _Console(Console):
    """A console whose reader may leave: `lidcam ... | head` ends the listing, not the work."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        # What is still in the buffers goes nowhere, and neither does what is printed by other means.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.file.fileno())
        os.close(nowhere)


def console(*, stderr: bool = False) -> Console:
    """A console that prints text as it is: names of topics and files may look like markup. Lines are not wrapped."""
    return _Console(stderr=stderr, soft_wrap=True, markup=False, emoji=False)
