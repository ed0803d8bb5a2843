"""The registry of formats for calibrated arms: a new one is a module and one entry here."""

from __future__ import annotations

from cellapp.errors import InputError
from cellapp.exports.dh_tables import DH, DH_PLAIN
from cellapp.exports.export_format import ExportFormat
from cellapp.exports.parameters import PARAMETERS
from cellapp.exports.poe_table import POE
from cellapp.exports.ur_calibration import UR_CALIBRATION
from cellapp.exports.ur_description import UR_DESCRIPTION
from cellapp.exports.urdf import URDF

_FORMATS = (UR_CALIBRATION, UR_DESCRIPTION, URDF, DH, DH_PLAIN, POE, PARAMETERS)
FORMATS: dict[str, ExportFormat] = {entry.name: entry for entry in _FORMATS}
"""All formats by name, in the order in which they are listed."""


def format_named(name: str) -> ExportFormat:
    """Return a format. Raises ``InputError``, which lists all formats, if there is none of that name."""
    if name not in FORMATS:
        raise InputError(
            f"export: there is no format '{name}'; --as takes {', '.join(FORMATS)}; 'cellapp docs exports' says more"
        )
    return FORMATS[name]
