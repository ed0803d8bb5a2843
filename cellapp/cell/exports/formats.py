"""Registry of the formats for calibrated arms, the whole cell, and commands.

A new format is a module and one entry here, or a plug-in.

Text about an export for people, in the file and on the terminal.

Paths of exported files: one file per arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from cellapp.cell.exports.arm_export import POSES, ExportResult, PositionLoss
from cellapp.cell.exports.command_table import COMMAND_TABLE, URSCRIPT
from cellapp.cell.exports.dh_tables import DH, DH_PLAIN, PARAMETERS, POE
from cellapp.cell.exports.export_format import CellFormat, CommandFormat, ExportFormat
from cellapp.cell.exports.urdf import CELL_URDF, UR_CALIBRATION, UR_DESCRIPTION, URDF
from cellapp.ground.counting import counted, mm
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


_TOGETHER = "all that is not rigid"


def form_line(form: AnyFormat, *, simulated: bool) -> str:
    """Return the first line of a file; ``simulated`` marks a simulated cell, whose numbers must not pass as real."""
    plugin = all_formats().plugin(form.name)
    writer = "cellapp" if plugin is None else f"{plugin.distribution} {plugin.version}, a plug-in of cellapp"
    return f"{form.what[0].upper()}{form.what[1:]}, by {writer}{', of a simulated cell' if simulated else ''}."


def lost_sentences(
    lost: Mapping[str, PositionLoss], together: PositionLoss | None, *, listed: bool = False
) -> list[str]:
    """Return sentences about what a file cannot represent."""
    if together is None:
        return ["The model of this arm is geometry alone: this file holds all of it."]
    rotated = "" if together.rms_mrad is None else " and the flange's rotation"
    lines = [
        f"{'The chain computes without' if listed else 'This file does not hold'} these parts of the model. How"
        f" far the SMR{rotated} is off without them,",
        f"at {POSES} random configurations within the joint ranges of the readings:",
    ]
    rows = [*lost.items()] if len(lost) == 1 else [*lost.items(), (_TOGETHER, together)]
    lines += [f"  {part}: {loss.words}" for part, loss in rows]
    return lines


def export_lines(result: ExportResult) -> list[str]:
    """Return lines about the files that were written and what they do not represent."""
    lines = [f"arm {name}: {counted(count, 'reading')}" for name, count in (result.readings or {}).items()]
    lines += [f"plan written to {result.plan}"] if result.plan is not None else []
    written = (result.csv, *(result.recordings or {}).values())
    lines += [f"written to {file}" for file in written if file is not None]
    for name, arm in (result.arms or {}).items():
        smr = ", ".join(f"{1e3 * value:.4f}" for value in arm.smr_m)
        lines += [
            f"arm {name}: written to {arm.file}",
            f"  its numbers are the identified geometry, {_within(arm.conversion_mm)}",
            f"  SMR in its last frame [mm]: {smr}",
            *(f"  {line}" for line in lost_sentences(arm.lost, arm.lost_together)),
        ]
    for name, arm_commands in (result.commands or {}).items():
        refused = f", {arm_commands.refused} left out" if arm_commands.refused else ""
        lines.append(f"arm {name}: {counted(arm_commands.commands, 'command')} written to {arm_commands.file}{refused}")
    return [*lines, *result.notes]


def _within(conversion_mm: float) -> str:
    return "unconverted" if conversion_mm == 0.0 else f"converted within {mm(max(conversion_mm, 1e-4))}"


def check_out(out: Path) -> None:
    """Raise ``InputError`` if ``out`` is not the path of a file."""
    if not out.name or out.is_dir():
        raise InputError(f"export: --out {out} is a folder; give the path of a file")


def files_of_arms(out: Path, arms: Sequence[str]) -> dict[str, Path]:
    """Return the file of each arm: ``out``, or, if there are several arms, with the arm's name before the suffix.

    Raise ``InputError`` if ``out`` is a folder, or an arm's name cannot be part of a file name.
    """
    check_out(out)
    if len(arms) == 1:
        return {arms[0]: out}
    for name in arms:
        if Path(name).name != name:
            raise InputError(f"export: '{name}' cannot be part of a file's name; write this arm alone with --arm")
    return {name: out.with_stem(f"{out.stem}-{name}") for name in arms}
