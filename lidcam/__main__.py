"""The programs `lidcam` and `lidcam-process`, and `python -m lidcam`."""

from lidcam.signals import end_at_signals


def main() -> None:
    """The program `lidcam`."""
    end_at_signals()
    from lidcam.cli import app  # loads libraries, which Ctrl-C may end
    from lidcam.cli.program import run_program

    run_program(app, "lidcam")


def main_process() -> None:
    """The program `lidcam-process`: `lidcam process`."""
    end_at_signals()
    from lidcam.cli import process_app
    from lidcam.cli.program import run_program

    run_program(process_app, "lidcam-process")


if __name__ == "__main__":
    main()
