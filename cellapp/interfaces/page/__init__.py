"""The page of a run, a certificate or a fleet as one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellapp.cell.run import RunFile


def write_page(run: RunFile) -> Path:
    """Write the page of a run into its folder and return the page's path. Raises ``InputError`` before calibration."""
    from cellapp.interfaces.page import page  # late: what draws it takes a second to load

    return page.write_page(run)
