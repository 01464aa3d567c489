"""What makes a start quick, for the programs: a library leaves its user's process alone."""

import os

from pipeline.core.garbage import collect_late

__all__ = ["start_quickly"]


def start_quickly() -> None:
    """Before libraries are imported: look for no garbage among them, and for none of pydantic's plugins.

    Settings are checked in the same way whatever else is installed; to look for plugins takes 10 to 20 ms.
    """
    collect_late()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
