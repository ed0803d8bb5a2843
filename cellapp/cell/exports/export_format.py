"""What a format declares. A new one is a module that ends with its declaration; see ``formats``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cellapp.cell.exports.arm_commands import ArmCommands
from cellapp.cell.exports.arm_export import ArmExport
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.plain_dh import plain_geometry
from cellapp.robot.kinematics.transforms import Array

Text = Callable[[ArmExport, Sequence[str]], str]
"""Writes an arm in one format, with sentences as its comment. Raises ``InputError`` for an arm that it cannot hold."""


def smr_in_plain_flange(export: ArmExport) -> Array:
    """SMR centre (3,) [m] in the last frame of the plain D-H rows."""
    return plain_geometry(export.geometry).tool


@dataclass(frozen=True)
class ExportFormat:
    """A format of files for calibrated arms.

    Attributes
    ----------
    name : str
        As ``--as`` takes it.
    what : str
        What the file is, in a few words.
    suffix : str
        Usual ending of its name.
    text : callable
        Writes the file.
    held : callable
        The chain that the numbers of the file are, from the identified one.
    smr : callable
        SMR centre (3,) [m] in the last frame of the file.
    """

    name: str
    what: str
    suffix: str
    text: Text
    held: Callable[[Geometry], Geometry] = lambda geometry: geometry
    smr: Callable[[ArmExport], Array] = lambda export: export.geometry.tool


@dataclass(frozen=True)
class CellFormat:
    """A format of files for the whole calibrated cell; ``text`` takes the arms by name. See ``ExportFormat``."""

    name: str
    what: str
    suffix: str
    text: Callable[[Mapping[str, ArmExport], Sequence[str]], str]


@dataclass(frozen=True)
class CommandFormat:
    """A format of files for the commands of one arm at targets; ``held`` counts those that a file has.

    ``drives`` says whether a controller runs the file as it is, so that its motions must have been checked.
    """

    name: str
    what: str
    suffix: str
    text: Callable[[ArmCommands, Sequence[str]], str]
    held: Callable[[ArmCommands], int]
    drives: bool = False
