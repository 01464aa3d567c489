"""The command line. Heavy imports stand in the functions that do the work, so help is instant."""

from shutil import get_terminal_size

import typer

from lidcam.cli.batch import BATCH_EXAMPLES, batch
from lidcam.cli.compare import COMPARE_EXAMPLES, compare
from lidcam.cli.config import config_app
from lidcam.cli.demo import demo
from lidcam.cli.evaluate import EVALUATE_EXAMPLES, evaluate
from lidcam.cli.fetch import FETCH_EXAMPLES, fetch
from lidcam.cli.inspect import INSPECT_EXAMPLES, inspect
from lidcam.cli.options import GroupedCommand, Program, Version
from lidcam.cli.process import PROCESS_EXAMPLES, process
from lidcam.cli.results import EXPORT_EXAMPLES, REPORT_EXAMPLES, VIEW_EXAMPLES, export, report, view
from lidcam.cli.simulation.adapt import ADAPT_EXAMPLES, adapt
from lidcam.cli.simulation.drive import DRIVE_EXAMPLES, drive
from lidcam.cli.simulation.simulate import SIMULATE_EXAMPLES, simulate
from lidcam.cli.simulation.train import train_app

__all__ = ["app", "process_app"]

# Without a width, help takes at least 50 columns.
HELP = {"help_option_names": ["-h", "--help"], "terminal_width": min(get_terminal_size().columns, 80) - 2}

app = typer.Typer(
    cls=Program,
    context_settings=HELP,
    help="Recorded lidar and camera topics in, fused objects out. ROS is not needed.\n\n"
    "To begin: `lidcam drive.bag` processes a recording into the folder drive.lidcam.",
    subcommand_metavar="RECORDING | COMMAND [ARGS]...",
    no_args_is_help=True,
    rich_markup_mode=None,  # plain text: the same on a terminal, in a log and in a file
    pretty_exceptions_enable=False,
)
process_app = typer.Typer(context_settings=HELP, rich_markup_mode=None, pretty_exceptions_enable=False)

# The help lists them in this order.
app.command(cls=GroupedCommand, epilog=PROCESS_EXAMPLES)(process)
app.command(cls=GroupedCommand, epilog=BATCH_EXAMPLES)(batch)
app.command(cls=GroupedCommand, epilog=INSPECT_EXAMPLES)(inspect)
app.command(cls=GroupedCommand, epilog=EVALUATE_EXAMPLES)(evaluate)
app.command(cls=GroupedCommand, epilog=COMPARE_EXAMPLES)(compare)
app.command(cls=GroupedCommand, epilog=EXPORT_EXAMPLES)(export)
app.command(cls=GroupedCommand, epilog=REPORT_EXAMPLES)(report)
app.command(cls=GroupedCommand, epilog=VIEW_EXAMPLES)(view)
app.command(cls=GroupedCommand)(demo)
app.command(cls=GroupedCommand, epilog=FETCH_EXAMPLES)(fetch)
app.command(cls=GroupedCommand, epilog=SIMULATE_EXAMPLES)(simulate)
app.command(cls=GroupedCommand, epilog=DRIVE_EXAMPLES)(drive)
app.command(cls=GroupedCommand, epilog=ADAPT_EXAMPLES)(adapt)
app.add_typer(train_app, name="train", help="Train your own networks on simulated worlds.")
app.add_typer(config_app, name="config", help="Show presets, and explain settings.")
process_app.command(cls=GroupedCommand, epilog=PROCESS_EXAMPLES)(process)


@app.callback()
def _common(_: Version = False) -> None:
    pass
