"""Opening of a page in a graphical browser, with a sentence about the outcome."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path


def open_page(page: Path) -> str:
    """Open a file in a browser; without a browser, the sentence says where the file is.

    A text browser is never started: it would draw over this program.
    """
    where = page.resolve()
    if _has_display():
        try:
            browser = webbrowser.get()
            in_terminal = type(browser) is webbrowser.GenericBrowser  # links, lynx, w3m
            if not in_terminal and browser.open(where.as_uri()):
                return f"The report opens in a browser: {where}"
        except (webbrowser.Error, OSError):
            pass
    return f"No browser with a window was found here; open {where} in one."


def _has_display() -> bool:
    if os.name != "posix" or sys.platform == "darwin":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
