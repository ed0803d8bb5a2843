"""The findings of ``doctor`` as sentences."""

from __future__ import annotations

from cellapp.cell.profile import load_profile
from cellapp.commands.doctor.profile_view import profile_tables
from cellapp.commands.doctor.request import DoctorRequest
from cellapp.commands.doctor.result import ControllerCalibration, DoctorResult
from cellapp.commands.record import View
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.chain import ROW_NAMES

_UNITS = ("mrad", "mm", "mm", "mrad", "mrad")


def view(result: DoctorResult, request: DoctorRequest | None = None) -> View:
    """Show on request the cell as in the profile, and every finding."""
    described = profile_tables(load_profile(request.profile)) if request is not None and request.cell else []
    findings = [f"{finding.status:8} {finding.subject}: {finding.text}" for finding in result.findings]
    tables = [_controller_table(name, its) for name, its in (result.controllers or {}).items()]
    written = [f"written: {path}" for path in result.written or ()]
    failed = f"{len(result.failed)} of {counted(len(result.findings), 'check')} failed"
    return View((*described, *findings, *tables, *written), (failed,) if result.failed else ())


def _controller_table(name: str, its: ControllerCalibration) -> Table:
    """Show what the factory calibration changes at each joint of an arm."""
    columns = (
        Column("joint"),
        *(number_column(f"{key} [{unit}]", "+.3f") for key, unit in zip(ROW_NAMES, _UNITS, strict=True)),
    )
    rows: list[tuple[Cell, ...]] = [
        (str(i), *(1e3 * value for value in row)) for i, row in enumerate(its.near, start=1)
    ]
    title = f"Arm {name}: the controller's own calibration ({its.checksum}), less the published rows"
    return Table(title, columns, tuple(rows))
