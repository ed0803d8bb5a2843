"""The page of a run or a certificate as one HTML file. Its slow drawing modules are imported late."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellapp.cell.run import RunFile
    from cellapp.commands.certificate_result import CertificateResult


def write_page(run: RunFile) -> Path:
    """Write the page of a run into its folder and return the page's path. Raises ``InputError`` before calibration."""
    from cellapp.interfaces.page import page

    return page.write_page(run)


def certificate_page(result: CertificateResult) -> str:
    """Return the page of a certificate as HTML."""
    from cellapp.interfaces.page import page

    return page.certificate_page(result)
