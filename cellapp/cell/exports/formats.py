"""Registry of the formats for calibrated arms, the whole cell, and commands.

A new format is a module and one entry here, or a plug-in.
"""

from __future__ import annotations

from typing import TypeVar

from cellapp.cell.exports.command_table import COMMAND_TABLE, URSCRIPT
from cellapp.cell.exports.dh_tables import DH, DH_PLAIN, PARAMETERS, POE
from cellapp.cell.exports.export_format import CellFormat, CommandFormat, ExportFormat
from cellapp.cell.exports.ur_description import UR_CALIBRATION, UR_DESCRIPTION
from cellapp.cell.exports.urdf import CELL_URDF, URDF
from cellapp.ground.errors import InputError
from drivers.plugins import Registry

AnyFormat = ExportFormat | CellFormat | CommandFormat
F = TypeVar("F", ExportFormat, CellFormat, CommandFormat)

_BUILT_IN: tuple[AnyFormat, ...] = (
    UR_CALIBRATION,
    UR_DESCRIPTION,
    URDF,
    DH,
    DH_PLAIN,
    POE,
    PARAMETERS,
    CELL_URDF,
    COMMAND_TABLE,
    URSCRIPT,
)


def _format(name: str, found: object) -> AnyFormat:
    """Check the format of a plug-in. Raise ``ValueError`` if it is not a format, or has another name."""
    if not isinstance(found, AnyFormat):
        raise ValueError(
            f"expected an ExportFormat, a CellFormat or a CommandFormat of"
            f" cellapp.cell.exports.export_format, got {found!r}"
        )
    if found.name != name:
        raise ValueError(f"the format is called '{found.name}'; the entry point must have the same name")
    return found


_REGISTRY: Registry[AnyFormat] = Registry(
    "cellapp.cell.exports", "export", {entry.name: entry for entry in _BUILT_IN}, _format
)


def all_formats() -> Registry[AnyFormat]:
    """Return all formats by name, in the order in which they are listed."""
    return _REGISTRY


def formats_of(type_: type[F]) -> dict[str, F]:
    """Return the formats for one calibrated arm, for the whole cell, or for commands at targets."""
    return {name: entry for name, entry in _REGISTRY.items() if isinstance(entry, type_)}


def format_named(name: str) -> AnyFormat:
    """Return a format. Raise ``InputError`` with a list of all formats if there is none of that name."""
    formats = all_formats()
    if name not in formats:
        takes = ", ".join(formats)
        missing = f"there is no format '{name}'; --as takes {takes}; 'cellapp docs exports' says more"
        raise InputError(f"export: {formats.refusal(name) or missing}")
    return formats[name]
