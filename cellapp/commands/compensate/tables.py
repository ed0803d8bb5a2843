"""Tables of targets: commands, predictions, unknown conditions, refusals, and measurements.

A list may have thousands of targets: a table shows those that need attention most, in the order of the list.
"""

from __future__ import annotations

import math

from cellapp.cell.targets.records import CompensateResult, MeasuredTarget, TargetCommand, VerifyResult
from cellapp.commands.calibrate.view import ERROR_COLUMNS, MM, error_cells
from cellapp.commands.compensate.words import PART_WORDS, Measured, all_measured, arms_words, shown_tolerance
from cellapp.commands.view.table import (
    MOST_ROWS,
    Cell,
    Field,
    Table,
    columns_of,
    most_urgent,
    part_table,
    table_of,
    without_empty,
)

_PAIRS = "between arms"
_COMMANDS = {"uncompensated": "nominal", "compensated": "compensated", "corrected": "corrected"}
"""Words for commands -> the beginning of the fields with their errors."""

_DEG = ".2f"
"""Number format of joint angles in degrees."""
_YES_NO = {True: "yes", False: "no", None: ""}
_TARGET: tuple[Field, ...] = (("target", "name"), ("arm", "arm"))
_BOUND: Field = ("95 % bound", "within_mm", MM)
_TOLERANCE: Field = ("tolerance", lambda one: shown_tolerance(one.tolerance_mm), "g")
_ROTATION_TOLERANCE: Field = ("tolerance", lambda one: shown_tolerance(one.orientation_tolerance_mrad), "g")
_NUMBERED: tuple[Field, ...] = (("number", lambda row: str(row[0])), ("target", lambda row: row[1].name))
"""First columns of rows (number, measurement)."""
_ERRORS: tuple[Field, ...] = (
    ("before", lambda row: row[1].nominal_mm, MM),
    ("after", lambda row: row[1].compensated_mm, MM),
    ("corrected", lambda row: row[1].final_mm if len(row[1].rounds_mm) > 1 else None, MM),
)
_MET: tuple[Field, ...] = (
    ("tolerance", lambda row: shown_tolerance(row[1].tolerance_mm), "g"),
    ("U", lambda row: row[1].expanded_mm if row[1].verdict else None, MM),
    ("met", lambda row: row[1].verdict),
)


def stored_tables(result: CompensateResult) -> list[Table]:
    """Show the tables of ``show DIR targets``: commands, uncertainties by source, tolerances."""
    return [*command_tables(result), *uncertainty_tables(result), *predicted_tables(result)]


def command_tables(result: CompensateResult) -> list[Table]:
    """Show compensated joint angles [deg] of every target that can be commanded, one table for each arm."""
    tables = []
    for arm in dict.fromkeys(target.arm for target in result.targets):
        commands = [
            (target.name, target.q_compensated)
            for target in result.targets
            if target.arm == arm and target.q_compensated is not None
        ]
        if commands:
            joints = len(commands[0][1])
            columns = columns_of("target", *((f"q{joint}", _DEG, "deg") for joint in range(1, joints + 1)))
            rows: list[tuple[Cell, ...]] = [(name, *map(math.degrees, q)) for name, q in commands]
            tables.append(part_table(f"Arm {arm}: compensated commands", columns, rows[:MOST_ROWS], len(rows)))
    return tables


def predicted_tables(result: CompensateResult) -> list[Table]:
    """Show whether commands should meet the tolerances; empty if no target has one."""
    judged = [target for target in result.targets if target.tolerance_mm is not None]
    table = table_of(
        "Predicted: targets with a tolerance [mm]",
        most_urgent(judged, _prediction_urgency),
        *_TARGET,
        ("standard uncertainty", "uncertainty_mm", MM),
        _BOUND,
        _TOLERANCE,
        ("tolerance met", lambda target: target.refusal or target.verdict),
        count=len(judged),
    )
    return [*([table] if judged else []), *angle_tables(result), *_relative_tables(result)]


def _relative_tables(result: CompensateResult) -> list[Table]:
    """Show what is predicted of the partner's flange seen from the first one; empty without two probes."""
    known = [target for target in result.targets if target.relative is not None]
    table = table_of(
        "Predicted: the partner's flange seen from the first one",
        known[:MOST_ROWS],
        ("target", "name"),
        ("arms", lambda one: arms_words((one.partner, one.arm))),
        ("95 % bound [mm]", "relative.within_mm", MM),
        ("tolerance [mm]", lambda one: shown_tolerance(one.tolerance_mm), "g"),
        ("met", "relative.verdict"),
        ("95 % bound [mrad]", "relative.within_mrad", MM),
        ("tolerance [mrad]", lambda one: shown_tolerance(one.orientation_tolerance_mrad), "g"),
        ("angle met", "relative.turn_verdict"),
        count=len(known),
    )
    return [without_empty(table)] if known else []


def angle_tables(result: CompensateResult) -> list[Table]:
    """Show the flange's rotation: by the published geometry, uncertainty with the compensated command, tolerance.

    Empty if no orientation was measured.
    """
    known = [target for target in result.targets if target.orientation is not None]
    table = table_of(
        "Predicted: rotation of the flange [mrad]",
        most_urgent(known, _rotation_urgency),
        *_TARGET,
        ("before", "orientation.nominal_mrad", MM),
        ("standard uncertainty", "orientation.uncertainty_mrad", MM),
        ("95 % bound", "orientation.within_mrad", MM),
        _ROTATION_TOLERANCE,
        ("tolerance met", "orientation.verdict"),
        count=len(known),
    )
    return [without_empty(table)] if known else []


def uncertainty_tables(result: CompensateResult) -> list[Table]:
    """Show the standard uncertainty of a coordinate at each command by sources, and the 95 % bound; empty if
    unknown."""
    known = [target for target in result.targets if target.parts is not None]
    table = table_of(
        "Standard uncertainty of a coordinate by its sources [mm]",
        most_urgent(known, lambda target: target.within_mm or 0.0),
        *_TARGET,
        *((word, f"parts.{part}", MM) for part, word in PART_WORDS.items()),
        ("together", "uncertainty_mm", MM),
        _BOUND,
        ("branches", "branches", "d"),
        ("tracker sees it", lambda target: _YES_NO[target.visible]),
        count=len(known),
    )
    return [table] if known else []


# -- measured ---------------------------------------------------------------------------------------------------------


def measured_targets(verify: VerifyResult, arm: str) -> list[MeasuredTarget]:
    """Return the targets of one arm measured with both commands, in the order of tables and charts."""
    own = [target for target in verify.targets if target.arm == arm]
    return [target for target in own if None not in (target.nominal_mm, target.compensated_mm)]


def measured_tables(verify: VerifyResult) -> list[Table]:
    """Show each target with its errors, one table for each arm; cooperative targets; targets without measurement."""
    return [*_arm_tables(verify), *measured_angle_tables(verify), *pair_tables(verify), *not_measured_tables(verify)]


def measured_angle_tables(verify: VerifyResult) -> list[Table]:
    """Show targets at which a probe measured the flange's rotation; empty if there are none."""
    measured = [target for target in verify.targets if target.orientation is not None]
    table = table_of(
        "Measured: rotation of the flange, angle from the target [mrad]",
        most_urgent(measured, lambda target: (target.orientation and target.orientation.final_mrad) or 0.0),
        *_TARGET,
        ("before", "orientation.nominal_mrad", MM),
        ("after", "orientation.final_mrad", MM),
        ("95 % bound", "orientation.within_mrad", MM),
        _ROTATION_TOLERANCE,
        ("U", lambda target: target.orientation.expanded_mrad if target.orientation.verdict else None, MM),
        ("met", "orientation.verdict"),
        count=len(measured),
    )
    return [without_empty(table)] if measured else []


def all_measured_tables(verify: VerifyResult) -> list[Table]:
    """Show the tables of ``show DIR verification``: statistics, then every target."""
    return [*verification_tables(verify), *measured_tables(verify)]


def pair_tables(verify: VerifyResult) -> list[Table]:
    """Show the error of the distance between both SMRs at cooperative targets; empty if there are none."""
    measured = [pair for pair in verify.pairs if pair.compensated_mm is not None]
    table = table_of(
        "Cooperative targets: error of the distance between both SMRs [mm]",
        list(enumerate(measured, start=1))[:MOST_ROWS],
        *_NUMBERED,
        ("arms", lambda row: arms_words(row[1].arms)),
        ("distance", lambda row: row[1].wanted_mm, ".3f"),
        *_ERRORS,
        *_MET,
        count=len(measured),
    )
    seen = [pair for pair in measured if pair.relative is not None]
    relative = table_of(
        "Cooperative targets: the partner's flange seen from the first one",
        seen[:MOST_ROWS],
        ("target", "name"),
        ("before [mm]", "relative.nominal_mm", MM),
        ("after [mm]", "relative.final_mm", MM),
        ("95 % bound [mm]", "relative.within_mm", MM),
        ("met", "relative.position_verdict"),
        ("before [mrad]", "relative.nominal_mrad", MM),
        ("after [mrad]", "relative.final_mrad", MM),
        ("95 % bound [mrad]", "relative.within_mrad", MM),
        ("angle met", "relative.verdict"),
        count=len(seen),
    )
    return [*([without_empty(table)] if measured else []), *([without_empty(relative)] if seen else [])]


def not_measured_tables(verify: VerifyResult) -> list[Table]:
    """Show targets without measurement, single and cooperative, and why."""
    without = [one for one in all_measured(verify) if one.note]
    fields: tuple[Field, ...] = (("target", "name"), ("arm", _arms), ("reason", "note"))
    table = table_of("Targets that were not measured", without[:MOST_ROWS], *fields, count=len(without))
    return [table] if without else []


def _arm_tables(verify: VerifyResult) -> list[Table]:
    tables = []
    for arm in verify.arms:
        measured = list(enumerate(measured_targets(verify, arm), start=1))
        table = table_of(
            f"Arm {arm}: each target [mm]",
            most_urgent(measured, lambda row: row[1].final_mm or 0.0),
            *_NUMBERED,
            ("frame", lambda row: "" if row[1].frame == "base" else row[1].frame),
            *_ERRORS,
            ("95 % bound", lambda row: row[1].within_mm, MM),
            *_MET,
            count=len(measured),
        )
        tables.append(without_empty(table))
    return tables


# -- inside -----------------------------------------------------------------------------------------------------------


def _prediction_urgency(target: TargetCommand) -> float:
    """Return a sort key: refused targets first, then by the bound as a share of the tolerance."""
    if target.refusal:
        return math.inf
    return (target.within_mm or target.uncertainty_mm or 0.0) / (target.tolerance_mm or math.inf)


def _rotation_urgency(target: TargetCommand) -> float:
    """Return a sort key: the bound of the flange's rotation as a share of its tolerance."""
    within = 0.0 if target.orientation is None else target.orientation.within_mrad
    return within / (target.orientation_tolerance_mrad or math.inf)


def verification_tables(result: VerifyResult) -> list[Table]:
    """Show errors at new targets before and after compensation, and the targets with a tolerance.

    Empty if no target was measured with both commands.
    """
    measured = dict(result.arms) if result.cooperative is None else {**result.arms, _PAIRS: result.cooperative}
    columns = columns_of("arm, command", *ERROR_COLUMNS)
    errors, angles = (
        tuple(
            (f"{name}, {label}", *error_cells(summary))
            for name, arm in measured.items()
            for label, field in _COMMANDS.items()
            if (summary := getattr(arm, f"{field}_{unit}", None)) is not None
        )
        for unit in ("mm", "mrad")
    )
    if not errors:
        return []
    return [
        Table("Targets: measured distance from where they should be [mm]", columns, errors),
        *([Table("Targets: measured angle from the rotation wanted [mrad]", columns, angles)] if angles else []),
        *_tolerance_tables(result),
    ]


def _tolerance_tables(result: VerifyResult) -> list[Table]:
    """Show targets with a tolerance; of many, those with the largest error as a share of it."""
    judged = [one for one in all_measured(result) if one.tolerance_mm is not None]
    table = table_of(
        "Targets with a tolerance [mm]",
        most_urgent(judged, lambda one: (one.final_mm or 0.0) / (one.tolerance_mm or math.inf)),
        ("target", "name"),
        ("arm", _arms),
        ("compensated", "final_mm", MM),
        _TOLERANCE,
        ("tolerance met", "verdict"),
        count=len(judged),
    )
    return [table] if judged else []


def _arms(one: Measured) -> str:
    return one.arm if isinstance(one, MeasuredTarget) else arms_words(one.arms)
