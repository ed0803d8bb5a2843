"""Choice of Textual's driver for the terminal."""

from __future__ import annotations

import sys

from textual.driver import Driver


def driver_that_stops(usual: type[Driver]) -> type[Driver]:
    """Return the driver whose thread handles STOP itself, if ``usual`` is that of a POSIX terminal; else ``usual``."""
    if sys.platform == "win32":
        return usual
    from textual.drivers.linux_driver import LinuxDriver  # which Windows cannot load

    from cellapp.interfaces.tui.urgent_keys import UrgentDriver

    return UrgentDriver if usual is LinuxDriver else usual
