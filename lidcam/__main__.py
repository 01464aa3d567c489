"""The programs `lidcam` and `lidcam-process`, and `python -m lidcam`."""

from lidcam.cli import app, process_app
from lidcam.program import run_program

__all__ = ["main", "main_process"]


def main() -> None:
    """The program `lidcam`."""
    run_program(app, "lidcam")


def main_process() -> None:
    """The program `lidcam-process`: `lidcam process`."""
    run_program(process_app, "lidcam-process")


if __name__ == "__main__":
    main()
