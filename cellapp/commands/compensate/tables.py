"""Tables of targets: commands, what is predicted of them, what is unknown, refusals, and what was measured.

A list may hold thousands of targets: a table shows those that need most attention, in the order of the list.
"""

from __future__ import annotations

import math

from cellapp.cell.targets.records import CompensateResult, MeasuredTarget, TargetCommand, VerifyResult
from cellapp.commands.calibrate.view import ERROR_COLUMNS, MM, error_cells
from cellapp.commands.compensate.words import (
    PART_WORDS,
    advice,
    all_measured,
    arms_words,
    shown_tolerance,
    unknown_conditions,
)
from cellapp.commands.view.table import (
    MOST_ROWS,
    Cell,
    Column,
    Table,
    most_urgent,
    number_column,
    part_table,
    without_empty,
)

_PAIRS = "between arms"

_DEG = ".2f"
"""Number format of joint angles in degrees."""
_YES_NO = {True: "yes", False: "no", None: ""}
_TARGET = (Column("target"), Column("arm"))


def stored_tables(result: CompensateResult) -> list[Table]:
    """What ``show DIR targets`` prints beside its sentences: commands, uncertainties by their parts, tolerances."""
    return [*command_tables(result), *uncertainty_tables(result), *predicted_tables(result)]


def command_tables(result: CompensateResult) -> list[Table]:
    """Compensated joint angles [deg] of every target that can be commanded, one table for each arm."""
    tables = []
    for arm in dict.fromkeys(target.arm for target in result.targets):
        commands = [
            (target.name, target.q_compensated)
            for target in result.targets
            if target.arm == arm and target.q_compensated is not None
        ]
        if commands:
            joints = len(commands[0][1])
            columns = (Column("target"), *(number_column(f"q{joint}", _DEG, "deg") for joint in range(1, joints + 1)))
            rows: list[tuple[Cell, ...]] = [(name, *map(math.degrees, q)) for name, q in commands]
            tables.append(part_table(f"Arm {arm}: compensated commands", columns, rows[:MOST_ROWS], len(rows)))
    return tables


def predicted_tables(result: CompensateResult) -> list[Table]:
    """Whether commands are expected to meet the tolerances; empty if no target has one."""
    judged = [target for target in result.targets if target.tolerance_mm is not None]
    if not judged:
        return []
    columns = (
        *_TARGET,
        number_column("standard uncertainty", MM),
        number_column("95 % bound", MM),
        number_column("tolerance", "g"),
        Column("tolerance met"),
    )
    rows: list[tuple[Cell, ...]] = [
        (
            target.name,
            target.arm,
            target.uncertainty_mm,
            target.within_mm,
            shown_tolerance(target.tolerance_mm),
            target.refusal or target.verdict,
        )
        for target in most_urgent(judged, _prediction_urgency)
    ]
    return [part_table("Predicted: targets with a tolerance [mm]", columns, rows, len(judged))]


def uncertainty_tables(result: CompensateResult) -> list[Table]:
    """Standard uncertainty of a coordinate at each command by its sources, and the 95 % bound; empty without parts."""
    known = [target for target in result.targets if target.parts is not None]
    if not known:
        return []
    columns = (
        *_TARGET,
        *(number_column(word, MM) for word in PART_WORDS.values()),
        number_column("together", MM),
        number_column("95 % bound", MM),
        number_column("branches", "d"),
        Column("tracker sees it"),
    )
    rows: list[tuple[Cell, ...]] = [
        (
            target.name,
            target.arm,
            *(getattr(target.parts, part) for part in PART_WORDS),
            target.uncertainty_mm,
            target.within_mm,
            target.branches,
            _YES_NO[target.visible],
        )
        for target in most_urgent(known, lambda target: target.within_mm or 0.0)
    ]
    return [part_table("Standard uncertainty of a coordinate by its sources [mm]", columns, rows, len(known))]


def unknown_tables(result: CompensateResult) -> list[Table]:
    """Conditions that nobody stated, by how much each moves the SMR, and where one states it."""
    rows: list[tuple[Cell, ...]] = [
        (one.condition, ", ".join(one.effects), one.mm, one.worst, one.targets, advice(one.condition))
        for one in unknown_conditions(result.targets)
    ]
    columns = (
        Column("not stated"),
        Column("effects"),
        number_column("up to", MM, "mm"),
        Column("at"),
        number_column("targets", "d"),
        Column("what to do"),
    )
    return [Table("Working conditions that nobody stated", columns, tuple(rows))] if rows else []


def refusal_tables(result: CompensateResult) -> list[Table]:
    """Targets that are not commanded, the reason, and what to do about it; empty if there are none."""
    refused = [target for target in result.targets if target.refusal]
    rows = [(target.name, target.arm, target.refusal, advice(target.refusal)) for target in refused[:MOST_ROWS]]
    columns = (*_TARGET, Column("refused because"), Column("what to do"))
    return [part_table("Refused targets", columns, rows, len(refused))] if refused else []


# -- measured ---------------------------------------------------------------------------------------------------------


def measured_targets(verify: VerifyResult, arm: str) -> list[MeasuredTarget]:
    """The targets of one arm that were measured with both commands: the order of tables and charts."""
    return [target for target in verify.targets if target.arm == arm and _measured(target)]


def measured_tables(verify: VerifyResult) -> list[Table]:
    """Each target with its errors, one table for each arm; cooperative targets; those without a measurement."""
    return [*_arm_tables(verify), *pair_tables(verify), *not_measured_tables(verify)]


def all_measured_tables(verify: VerifyResult) -> list[Table]:
    """What ``show DIR verification`` prints: statistics, then every target."""
    return [*verification_tables(verify), *measured_tables(verify)]


def pair_tables(verify: VerifyResult) -> list[Table]:
    """Cooperative targets: by how much the distance between both SMRs was off; empty without them."""
    columns = (
        Column("number"),
        Column("target"),
        Column("arms"),
        number_column("distance", ".3f"),
        number_column("before", MM),
        number_column("after", MM),
        number_column("corrected", MM),
        number_column("tolerance", "g"),
        number_column("U", MM),
        Column("met"),
    )
    measured = [pair for pair in verify.pairs if pair.compensated_mm is not None]
    rows: list[tuple[Cell, ...]] = [
        (
            str(number),
            pair.name,
            arms_words(pair.arms),
            pair.wanted_mm,
            pair.nominal_mm,
            pair.compensated_mm,
            pair.final_mm if len(pair.rounds_mm) > 1 else None,
            shown_tolerance(pair.tolerance_mm),
            pair.expanded_mm if pair.verdict else None,
            pair.verdict,
        )
        for number, pair in enumerate(measured, start=1)
    ]
    title = "Cooperative targets: error of the distance between both SMRs [mm]"
    return [without_empty(part_table(title, columns, rows[:MOST_ROWS], len(rows)))] if rows else []


def not_measured_tables(verify: VerifyResult) -> list[Table]:
    """Targets, single and cooperative, that have no measurement, and why."""
    rows = [(target.name, target.arm, target.note) for target in verify.targets if target.note]
    rows += [(pair.name, arms_words(pair.arms), pair.note) for pair in verify.pairs if pair.note]
    columns = (*_TARGET, Column("reason"))
    return [part_table("Targets that were not measured", columns, rows[:MOST_ROWS], len(rows))] if rows else []


def _arm_tables(verify: VerifyResult) -> list[Table]:
    columns = (
        Column("number"),
        Column("target"),
        Column("frame"),
        number_column("before", MM),
        number_column("after", MM),
        number_column("corrected", MM),
        number_column("95 % bound", MM),
        number_column("tolerance", "g"),
        number_column("U", MM),
        Column("met"),
    )
    tables = []
    for arm in verify.arms:
        measured = list(enumerate(measured_targets(verify, arm), start=1))
        rows: list[tuple[Cell, ...]] = [
            (
                str(number),
                target.name,
                "" if target.frame == "base" else target.frame,
                target.nominal_mm,
                target.compensated_mm,
                target.final_mm if len(target.rounds_mm) > 1 else None,
                target.within_mm,
                shown_tolerance(target.tolerance_mm),
                target.expanded_mm if target.verdict else None,
                target.verdict,
            )
            for number, target in most_urgent(measured, lambda row: row[1].final_mm or 0.0)
        ]
        tables.append(without_empty(part_table(f"Arm {arm}: each target [mm]", columns, rows, len(measured))))
    return tables


# -- inside -----------------------------------------------------------------------------------------------------------


def _prediction_urgency(target: TargetCommand) -> float:
    """Refused ones first, then by the bound as a share of the tolerance."""
    if target.refusal:
        return math.inf
    return (target.within_mm or target.uncertainty_mm or 0.0) / (target.tolerance_mm or math.inf)


def _measured(target: MeasuredTarget) -> bool:
    return target.nominal_mm is not None and target.compensated_mm is not None


def verification_tables(result: VerifyResult) -> list[Table]:
    """Errors at new targets before and after compensation, and the targets with a tolerance.

    Empty if no target was measured with both commands.
    """
    measured = dict(result.arms) if result.cooperative is None else {**result.arms, _PAIRS: result.cooperative}
    rows = [
        (f"{name}, {label}", *error_cells(summary))
        for name, arm in measured.items()
        for label, summary in (("uncompensated", arm.nominal_mm), ("compensated", arm.compensated_mm))
    ]
    if not rows:
        return []
    title = "Targets: measured distance from where they should be [mm]"
    return [Table(title, (Column("arm, command"), *ERROR_COLUMNS), tuple(rows)), *_tolerance_tables(result)]


def _tolerance_tables(result: VerifyResult) -> list[Table]:
    """Single and cooperative targets with a tolerance; where these are many, those with the largest share of it."""
    judged = [one for one in all_measured(result) if one.tolerance_mm is not None]
    rows: list[tuple[Cell, ...]] = [
        (
            one.name,
            one.arm if isinstance(one, MeasuredTarget) else arms_words(one.arms),
            one.final_mm,
            shown_tolerance(one.tolerance_mm),
            one.verdict,
        )
        for one in most_urgent(judged, lambda one: (one.final_mm or 0.0) / (one.tolerance_mm or math.inf))
    ]
    columns = (
        Column("target"),
        Column("arm"),
        number_column("compensated", MM),
        number_column("tolerance", "g"),
        Column("tolerance met"),
    )
    return [part_table("Targets with a tolerance [mm]", columns, rows, len(judged))] if rows else []
