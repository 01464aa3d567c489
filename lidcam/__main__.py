"""The programs `lidcam` and `lidcam-process`, and `python -m lidcam`."""

from lidcam.packages import check_own_packages

__all__ = ["main", "main_process"]


def main() -> None:
    """The program `lidcam`."""
    check_own_packages()
    from lidcam.cli import app, run_program  # what it imports has just been looked at

    run_program(app, "lidcam")


def main_process() -> None:
    """The program `lidcam-process`: `lidcam process`."""
    check_own_packages()
    from lidcam.cli import process_app, run_program

    run_program(process_app, "lidcam-process")


if __name__ == "__main__":
    main()
