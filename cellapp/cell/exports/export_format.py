"""Declarations of formats. A new format is a module that ends with its declaration; see ``formats``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cellapp.cell.exports.arm_commands import ArmCommands
from cellapp.cell.exports.arm_export import ArmExport
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.plain_dh import plain_geometry
from cellapp.robot.kinematics.transforms import Array

Text = Callable[[ArmExport, Sequence[str]], str]
"""Function that writes an arm in one format, with sentences as a comment; raises ``InputError`` if it cannot."""


def smr_in_plain_flange(export: ArmExport) -> Array:
    """Return the SMR centre (3,) [m] in the last frame of the plain D-H rows."""
    return plain_geometry(export.geometry).tool


@dataclass(frozen=True)
class ExportFormat:
    """Format of files for calibrated arms.

    Attributes
    ----------
    name : str
        Value for ``--as``.
    what : str
        What the file is, in a few words.
    suffix : str
        Usual file name suffix.
    text : callable
        Function that returns the text of the file.
    held : callable
        Function that returns the chain represented by the file's numbers, from the identified chain.
    smr : callable
        Function that returns the SMR centre (3,) [m] in the last frame of the file.
    lists_effects : bool
        Whether the file lists the values of effects, though no chain computes them.
    """

    name: str
    what: str
    suffix: str
    text: Text
    held: Callable[[Geometry], Geometry] = lambda geometry: geometry
    smr: Callable[[ArmExport], Array] = lambda export: export.geometry.tool
    lists_effects: bool = False


@dataclass(frozen=True)
class CellFormat:
    """Format of files for the whole calibrated cell; ``text`` takes the arms by name. See ``ExportFormat``."""

    name: str
    what: str
    suffix: str
    text: Callable[[Mapping[str, ArmExport], Sequence[str]], str]


@dataclass(frozen=True)
class CommandFormat:
    """Format of files for the commands of one arm at targets; ``held`` returns the number of commands in a file.

    ``drives`` means that a controller runs the file as it is, so that its motions must have been checked.
    """

    name: str
    what: str
    suffix: str
    text: Callable[[ArmCommands, Sequence[str]], str]
    held: Callable[[ArmCommands], int]
    drives: bool = False
