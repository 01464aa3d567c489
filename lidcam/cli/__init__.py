"""The command line: what each command takes. It parses, checks what is wrong usage, and calls the command."""

import typer

from lidcam.cli.config import config_app
from lidcam.cli.demo import demo
from lidcam.cli.inspect import INSPECT_EXAMPLES, inspect
from lidcam.cli.measure import COMPARE_EXAMPLES, EVALUATE_EXAMPLES, compare, evaluate
from lidcam.cli.process import PROCESS_EXAMPLES, process
from lidcam.cli.simulate import DRIVE_EXAMPLES, SIMULATE_EXAMPLES, drive, simulate
from lidcam.options import Version

__all__ = ["app", "process_app"]

HELP_NAMES = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    context_settings=HELP_NAMES,
    help="Recorded lidar and camera topics in, fused objects out. No ROS installed.",
    no_args_is_help=True,
    rich_markup_mode=None,  # plain text: the same on a terminal, in a log and in a file
    pretty_exceptions_enable=False,
)
process_app = typer.Typer(context_settings=HELP_NAMES, rich_markup_mode=None, pretty_exceptions_enable=False)

# The help lists them in this order.
app.command(epilog=PROCESS_EXAMPLES)(process)
app.command(epilog=INSPECT_EXAMPLES)(inspect)
app.command(epilog=EVALUATE_EXAMPLES)(evaluate)
app.command(epilog=COMPARE_EXAMPLES)(compare)
app.command()(demo)
app.command(epilog=SIMULATE_EXAMPLES)(simulate)
app.command(epilog=DRIVE_EXAMPLES)(drive)
app.add_typer(config_app, name="config", help="The presets, and what the settings mean.")
process_app.command(epilog=PROCESS_EXAMPLES)(process)


@app.callback()
def _common(_: Version = False) -> None:
    pass
