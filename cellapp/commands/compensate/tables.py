"""Tables of targets: commands, predictions, unknown conditions, refusals, and measurements.

A list may have thousands of targets: a table shows those that need attention most, in the order of the list.
"""

from __future__ import annotations

import math
from operator import itemgetter

from cellapp.cell.targets.records import CompensateResult, MeasuredTarget, TargetCommand, VerifyResult
from cellapp.commands.calibrate.view import MM, error_table
from cellapp.commands.compensate.words import PART_WORDS, Measured, all_measured, arms_words, shown_tolerance
from cellapp.commands.view.table import Field, Table, urgent_rows, with_rows
from cellapp.ground.grouping import grouped

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
    commands = grouped((one.arm, (one.name, *one.q_compensated)) for one in result.targets if one.q_compensated)
    return [
        table
        for arm, rows in commands.items()
        for table in urgent_rows(
            f"Arm {arm}: compensated commands",
            rows,
            ("target", itemgetter(0)),
            *((f"q{j}", lambda row, j=j: math.degrees(row[j]), _DEG, "deg") for j in range(1, len(rows[0]))),
        )
    ]


def predicted_tables(result: CompensateResult) -> list[Table]:
    """Show whether commands should meet the tolerances; empty if no target has one."""
    judged = [target for target in result.targets if target.tolerance_mm is not None]
    tables = urgent_rows(
        "Predicted: targets with a tolerance [mm]",
        judged,
        *_TARGET,
        ("standard uncertainty", "uncertainty_mm", MM),
        _BOUND,
        _TOLERANCE,
        ("tolerance met", lambda target: target.refusal or target.verdict),
        urgency=_prediction_urgency,
    )
    return [*tables, *angle_tables(result), *_relative_tables(result)]


def _relative_tables(result: CompensateResult) -> list[Table]:
    """Show what is predicted of the partner's flange seen from the first one; empty without two probes."""
    return urgent_rows(
        "Predicted: the partner's flange seen from the first one",
        [target for target in result.targets if target.relative is not None],
        ("target", "name"),
        ("arms", lambda one: arms_words((one.partner, one.arm))),
        ("95 % bound [mm]", "relative.within_mm", MM),
        ("tolerance [mm]", lambda one: shown_tolerance(one.tolerance_mm), "g"),
        ("met", "relative.verdict"),
        ("95 % bound [mrad]", "relative.within_mrad", MM),
        ("tolerance [mrad]", lambda one: shown_tolerance(one.orientation_tolerance_mrad), "g"),
        ("angle met", "relative.turn_verdict"),
    )


def angle_tables(result: CompensateResult) -> list[Table]:
    """Show the flange's rotation: by the published geometry, uncertainty with the compensated command, tolerance.

    Empty if no orientation was measured.
    """
    return urgent_rows(
        "Predicted: rotation of the flange [mrad]",
        [target for target in result.targets if target.orientation is not None],
        *_TARGET,
        ("before", "orientation.nominal_mrad", MM),
        ("standard uncertainty", "orientation.uncertainty_mrad", MM),
        ("95 % bound", "orientation.within_mrad", MM),
        _ROTATION_TOLERANCE,
        ("tolerance met", "orientation.verdict"),
        urgency=_rotation_urgency,
    )


def uncertainty_tables(result: CompensateResult) -> list[Table]:
    """Show the standard uncertainty of a coordinate at each command by sources, and the 95 % bound; empty if
    unknown."""
    return urgent_rows(
        "Standard uncertainty of a coordinate by its sources [mm]",
        [target for target in result.targets if target.parts is not None],
        *_TARGET,
        *((word, f"parts.{part}", MM) for part, word in PART_WORDS.items()),
        ("together", "uncertainty_mm", MM),
        _BOUND,
        ("branches", "branches", "d"),
        ("tracker sees it", lambda target: _YES_NO[target.visible]),
        urgency=lambda target: target.within_mm or 0.0,
    )


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
    return urgent_rows(
        "Measured: rotation of the flange, angle from the target [mrad]",
        [target for target in verify.targets if target.orientation is not None],
        *_TARGET,
        ("before", "orientation.nominal_mrad", MM),
        ("after", "orientation.final_mrad", MM),
        ("95 % bound", "orientation.within_mrad", MM),
        _ROTATION_TOLERANCE,
        ("U", lambda target: target.orientation.expanded_mrad if target.orientation.verdict else None, MM),
        ("met", "orientation.verdict"),
        urgency=lambda target: (target.orientation and target.orientation.final_mrad) or 0.0,
    )


def all_measured_tables(verify: VerifyResult) -> list[Table]:
    """Show the tables of ``show DIR verification``: statistics, then every target."""
    return [*verification_tables(verify), *measured_tables(verify)]


def pair_tables(verify: VerifyResult) -> list[Table]:
    """Show the error of the distance between both SMRs at cooperative targets; empty if there are none."""
    measured = [pair for pair in verify.pairs if pair.compensated_mm is not None]
    distances = urgent_rows(
        "Cooperative targets: error of the distance between both SMRs [mm]",
        list(enumerate(measured, start=1)),
        *_NUMBERED,
        ("arms", lambda row: arms_words(row[1].arms)),
        ("distance", lambda row: row[1].wanted_mm, ".3f"),
        *_ERRORS,
        *_MET,
    )
    relative = urgent_rows(
        "Cooperative targets: the partner's flange seen from the first one",
        [pair for pair in measured if pair.relative is not None],
        ("target", "name"),
        ("before [mm]", "relative.nominal_mm", MM),
        ("after [mm]", "relative.final_mm", MM),
        ("95 % bound [mm]", "relative.within_mm", MM),
        ("met", "relative.position_verdict"),
        ("before [mrad]", "relative.nominal_mrad", MM),
        ("after [mrad]", "relative.final_mrad", MM),
        ("95 % bound [mrad]", "relative.within_mrad", MM),
        ("angle met", "relative.verdict"),
    )
    return [*distances, *relative]


def not_measured_tables(verify: VerifyResult) -> list[Table]:
    """Show targets without measurement, single and cooperative, and why."""
    without = [one for one in all_measured(verify) if one.note]
    fields: tuple[Field, ...] = (("target", "name"), ("arm", _arms), ("reason", "note"))
    return urgent_rows("Targets that were not measured", without, *fields)


def _arm_tables(verify: VerifyResult) -> list[Table]:
    return [
        table
        for arm in verify.arms
        for table in urgent_rows(
            f"Arm {arm}: each target [mm]",
            list(enumerate(measured_targets(verify, arm), start=1)),
            *_NUMBERED,
            ("frame", lambda row: "" if row[1].frame == "base" else row[1].frame),
            *_ERRORS,
            ("95 % bound", lambda row: row[1].within_mm, MM),
            *_MET,
            urgency=lambda row: row[1].final_mm or 0.0,
        )
    ]


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
    """Show errors at new targets before and after compensation.

    Empty if no target was measured with both commands.
    """
    measured = dict(result.arms) if result.cooperative is None else {**result.arms, _PAIRS: result.cooperative}
    if not measured:
        return []
    units = {"distance from where they should be": "mm", "angle from the rotation wanted": "mrad"}
    errors = (
        error_table(
            f"Targets: measured {what} [{unit}]",
            "arm, command",
            (
                (f"{name}, {command}", errors)
                for name, arm in measured.items()
                for command, key in _COMMANDS.items()
                if (errors := getattr(arm, f"{key}_{unit}", None)) is not None
            ),
        )
        for what, unit in units.items()
    )
    return with_rows(*errors)


def _arms(one: Measured) -> str:
    return one.arm if isinstance(one, MeasuredTarget) else arms_words(one.arms)
