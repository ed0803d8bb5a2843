"""The registry of formats, for calibrated arms, the whole cell, and commands: a new one is a module and one entry."""

from __future__ import annotations

from cellapp.errors import InputError
from cellapp.exports.cell_urdf import CELL_URDF
from cellapp.exports.command_table import COMMAND_TABLE
from cellapp.exports.dh_tables import DH, DH_PLAIN
from cellapp.exports.export_format import CellFormat, CommandFormat, ExportFormat
from cellapp.exports.parameters import PARAMETERS
from cellapp.exports.poe_table import POE
from cellapp.exports.ur_calibration import UR_CALIBRATION
from cellapp.exports.ur_description import UR_DESCRIPTION
from cellapp.exports.urdf import URDF
from cellapp.exports.urscript_commands import URSCRIPT

_FORMATS = (UR_CALIBRATION, UR_DESCRIPTION, URDF, DH, DH_PLAIN, POE, PARAMETERS)
FORMATS: dict[str, ExportFormat] = {entry.name: entry for entry in _FORMATS}
"""Formats for one calibrated arm by name, in the order in which they are listed."""
CELL_FORMATS: dict[str, CellFormat] = {entry.name: entry for entry in (CELL_URDF,)}
"""Formats for the whole cell."""
COMMAND_FORMATS: dict[str, CommandFormat] = {entry.name: entry for entry in (COMMAND_TABLE, URSCRIPT)}
"""Formats for commands at targets."""

AnyFormat = ExportFormat | CellFormat | CommandFormat


def all_formats() -> dict[str, AnyFormat]:
    """Every format by name, in the order in which they are listed."""
    return {**FORMATS, **CELL_FORMATS, **COMMAND_FORMATS}


def format_named(name: str) -> AnyFormat:
    """Return a format. Raises ``InputError``, which lists all formats, if there is none of that name."""
    formats = all_formats()
    if name not in formats:
        raise InputError(
            f"export: there is no format '{name}'; --as takes {', '.join(formats)}; 'cellapp docs exports' says more"
        )
    return formats[name]
