"""The HTML page of a result."""

from __future__ import annotations

from pathlib import Path

from cellapp.estimation.monitoring.fleet.records import FleetResult
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import Outputs
from cellapp.ground.results import Result
from cellapp.interfaces.page.fleet_page import write_fleet_page


def write_result_page(result: Result, path: Path, outputs: Outputs) -> Path:
    """Write the page of a result. Raises ``InputError`` where it has none, or the file cannot be written."""
    if isinstance(result, FleetResult):
        return write_fleet_page(result, path, outputs)
    raise InputError(f"{path}: {result.schema_} has no page")
