"""The command `lidcam fetch`."""

from typing import Annotated

import typer

from lidcam.cli.options import with_log_options
from lidcam.cli.printing.log import remark_log
from lidcam.networks.known import NETWORKS, NetworkName

FETCH_EXAMPLES = """\b
Examples:
  lidcam fetch yolox-nano
  lidcam drive.bag
"""


@with_log_options
def fetch(
    name: Annotated[NetworkName, typer.Argument(metavar="NAME", help="yolox-nano, yolox-tiny or yolox-s.")],
) -> None:
    """Download a 2D network from its publisher, once.

    It is kept in your data folder if size and SHA-256 match. From then on it runs by default in recordings with images
    and no 2D boxes. No other command downloads networks.
    """
    from pathlib import Path

    from lidcam.cli.printing.terminal import console, show_line
    from lidcam.networks.fetch import fetch_network, is_fetched
    from lidcam.networks.known import network_path

    network, out = NETWORKS[name], console()
    show_line(out, f"{name}, {network.size_bytes / 1e6:.1f} MB: {network.address}")
    show_line(out, f"licence {network.licence}: {network.licence_address}")
    if is_fetched(name):
        remark_log.info("%s already exists", network_path(Path(name)))
    else:
        remark_log.info("wrote %s", fetch_network(name))
