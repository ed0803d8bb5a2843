"""Which driver of Textual reads the terminal."""

from __future__ import annotations

import sys

from textual.driver import Driver


def driver_that_stops(usual: type[Driver]) -> type[Driver]:
    """The driver whose thread gives a STOP itself, in place of the usual one of a POSIX terminal."""
    if sys.platform == "win32":
        return usual
    from textual.drivers.linux_driver import LinuxDriver  # which Windows cannot load

    from cellapp.interfaces.tui.urgent_keys import UrgentDriver

    return UrgentDriver if usual is LinuxDriver else usual
