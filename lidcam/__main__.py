"""The programs `lidcam` and `lidcam-process`, and `python -m lidcam`."""

import sys

import lidcam

sys.excepthook = lidcam._interrupted  # for Ctrl-C until signals are taken care of

from lidcam.start.quick import start_quickly  # noqa: E402  # as the next
from lidcam.start.signals import end_at_signals  # noqa: E402  # behind the hook, which is for it

__all__ = ["main", "main_process"]


def main() -> None:
    """The program `lidcam`."""
    end_at_signals()
    start_quickly()
    from lidcam.cli import app
    from lidcam.program import run_program

    run_program(app, "lidcam")


def main_process() -> None:
    """The program `lidcam-process`: `lidcam process`."""
    end_at_signals()
    start_quickly()
    from lidcam.cli import process_app
    from lidcam.program import run_program

    run_program(process_app, "lidcam-process")


if __name__ == "__main__":
    main()
