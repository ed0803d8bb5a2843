"""Tables of an earlier calibration used as prior: how far it was believed, and what has changed since."""

from __future__ import annotations

from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.commands.view.words import display_unit
from cellapp.estimation.calibration.records import ArmPriorResult, CalibrateResult, PartDrift
from cellapp.ground.counting import counted
from cellapp.robot.effects import EFFECTS


def prior_tables(result: CalibrateResult) -> list[Table]:
    """Show parts and changes of every arm that was calibrated with a prior; none without one."""
    tables = []
    for name, arm in result.arms.items():
        if arm.prior is not None:
            tables.append(_part_table(name, arm.prior))
            if arm.prior.changes:
                tables.append(_change_table(name, arm.prior))
    return tables


def prior_sentences(result: CalibrateResult) -> list[str]:
    """Say where the prior of each arm comes from, and whether the arm has changed since."""
    said = []
    for name, arm in result.arms.items():
        if (prior := arm.prior) is None:
            continue
        effects = ", ".join(EFFECTS[slug].title for slug in prior.effects if slug in EFFECTS)
        left = ", ".join(EFFECTS[slug].title for slug in prior.left_behind if slug in EFFECTS)
        said.append(
            f"arm {name}: {prior.run} ({prior.since}, {counted(prior.readings, 'reading')}) is the prior; carried over:"
            f" geometry{f', {effects}' if effects else ''}"
            + (f"; of the earlier installation, not carried over: {left}" if left else "")
        )
        if not prior.changes:
            said.append(f"arm {name}: no change of a single parameter is proven ({prior.tested} were tested)")
    return said


def _part_table(name: str, prior: ArmPriorResult) -> Table:
    columns = (
        Column("part"),
        number_column("values", "d"),
        number_column("may have drifted", ".3g"),
        Column("unit"),
        Column("believed"),
    )
    rows = [
        (part, one.parameters, *_drift(one), "yes" if one.used else "no: the readings contradict it")
        for part, one in prior.parts.items()
    ]
    return Table(f"Arm {name}: earlier calibration of {prior.since}", columns, tuple(rows))


def _drift(one: PartDrift) -> tuple[Cell, Cell]:
    if one.drift is None:
        return None, ""
    if one.unit == "m, rad":
        return one.drift * 1e6, "µm, µrad"
    return one.drift * 100.0, f"% {one.unit}"


def _change_table(name: str, prior: ArmPriorResult) -> Table:
    columns = (
        Column("what"),
        number_column("change", "+.3f"),
        number_column("standard error", ".3f"),
        Column("unit"),
        number_column("sigmas", ".1f"),
        number_column("evidence", ".0f"),
        number_column("at the SMR", ".3f", "mm"),
        Column("as likely"),
    )
    rows: list[tuple[Cell, ...]] = []
    for one in prior.changes:
        factor, unit = display_unit(one.unit) if one.unit else (1.0, "")
        scaled = (None if value is None else value * factor for value in (one.value, one.standard_error))
        likely = ", ".join(one.rivals)
        rows.append((one.what, *scaled, unit, one.sigmas, one.evidence, one.moved_mm, likely))
    return Table(f"Arm {name}: changed since {prior.since}", columns, tuple(rows))
