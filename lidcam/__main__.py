"""The programs `lidcam` and `lidcam-process`, and `python -m lidcam`."""

from lidcam.start.signals import end_at_signals

__all__ = ["main", "main_process"]


def main() -> None:
    """The program `lidcam`."""
    end_at_signals()
    from lidcam.cli import app  # loads libraries: from here on, Ctrl-C ends the program well
    from lidcam.program import run_program

    run_program(app, "lidcam")


def main_process() -> None:
    """The program `lidcam-process`: `lidcam process`."""
    end_at_signals()
    from lidcam.cli import process_app  # as above
    from lidcam.program import run_program

    run_program(process_app, "lidcam-process")


if __name__ == "__main__":
    main()
