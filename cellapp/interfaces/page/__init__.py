"""The page of a run, a certificate or a fleet as one HTML file. Its slow drawing modules are imported late."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.ground.errors import InputError

if TYPE_CHECKING:
    from cellapp.cell.run import RunFile
    from cellapp.commands.certificate.result import CertificateResult
    from cellapp.ground.outputs import Outputs
    from cellapp.ground.results import Result


def write_page(run: RunFile) -> Path:
    """Write the page of a run into its folder and return the page's path. Raises ``InputError`` before calibration."""
    from cellapp.interfaces.page import page

    return page.write_page(run)


def draw_certificate(result: CertificateResult) -> str:
    """Return the page of a certificate as HTML."""
    from cellapp.interfaces.page.certificate_page import certificate_page as drawn

    return drawn(result)


def write_result_page(result: Result, path: Path, outputs: Outputs) -> Path:
    """Write the page of a result and return its path. Raises ``InputError`` if it has none, or cannot be written."""
    from cellapp.estimation.monitoring.fleet.records import FleetResult
    from cellapp.interfaces.page.fleet_page import write_fleet_page

    if isinstance(result, FleetResult):
        return write_fleet_page(result, path, outputs)
    raise InputError(f"{path}: {result.schema_} has no page")
