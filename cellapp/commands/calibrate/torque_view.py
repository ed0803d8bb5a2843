"""Masses and motor constants of an arm from measured torques or currents, for people."""

from __future__ import annotations

from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.estimation.calibration.records import CalibrateResult, TorquesResult
from cellapp.ground.counting import counted

_UNITS = {"tau": "Nm", "current": "A"}


def torque_tables(result: CalibrateResult) -> list[Table]:
    """Show motor constants, friction and scatter by joint, one table for each arm with torques or currents."""
    tables = []
    for name, arm in result.arms.items():
        if arm.torques is None:
            continue
        unit = _UNITS[arm.torques.kind]
        columns = (
            Column("joint"),
            number_column("motor constant [Nm/A]", ".3f"),
            number_column("standard error [Nm/A]", ".3f"),
            number_column(f"friction [{unit}]", ".3f"),
            number_column(f"offset [{unit}]", ".3f"),
            number_column(f"scatter [{unit}]", ".3f"),
        )
        rows: list[tuple[Cell, ...]] = []
        for one in arm.torques.joints:
            constant = (None, None) if one.constant is None else (one.constant.value, one.constant.standard_error)
            rows.append((str(one.joint), *constant, one.friction, one.offset, one.scatter))
        what = "torques" if arm.torques.kind == "tau" else "motor currents"
        tables.append(Table(f"Arm {name}: measured {what}", columns, tuple(rows)))
    return tables


def torque_sentences(result: CalibrateResult) -> list[str]:
    """Say whether masses from torques replace the stated ones, and which joints' torques cannot be used and why."""
    said = []
    for name, arm in result.arms.items():
        if arm.torques is not None:
            said.append(f"arm {name}: {torque_words(arm.torques)}")
            said += [f"arm {name}: joint {one.joint}: {one.fault}" for one in arm.torques.joints if one.fault]
            said += [f"arm {name}: torques left out: {fault}" for fault in arm.torques.faults]
    return said


def torque_words(found: TorquesResult) -> str:
    """Return one sentence on the masses of one arm."""
    if all(one.fault for one in found.joints):
        return "no joint's torques can be used; the stated masses stay"
    what = "torques" if found.kind == "tau" else "currents"
    before, after = found.heldout_nm.before, found.heldout_nm.after
    errors = f"{after:.2f} Nm rms of held-out ones, the stated masses {before:.2f} Nm"
    verdict = "they drive elasticity" if found.used else "the stated masses stay: these are not surely better"
    return (
        f"masses from the {what} of {counted(found.readings, 'reading')} leave {errors}; the log likelihood of"
        f" positions with elastic joints changes by {found.evidence:+.1f} with them; {verdict}"
    )
