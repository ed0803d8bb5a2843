"""Tables of targets: commands, predictions, and measurements.

A list may have thousands of targets: a table shows those that need attention most, in the order of the list.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import Any

from cellapp.cell.targets.records import CompensateResult, MeasuredTarget, TargetCommand, VerifyResult
from cellapp.commands.calibrate.view import MM, error_table
from cellapp.commands.compensate.words import PART_WORDS, arms_words, shown_tolerance
from cellapp.commands.view.table import Field, Table, urgent_rows, with_rows
from cellapp.ground.grouping import grouped

_PAIRS = "between arms"
_COMMANDS = {"uncompensated": "nominal", "compensated": "compensated", "corrected": "corrected"}
"""Words for commands -> the beginning of the fields with their errors."""

_DEG = ".2f"
"""Number format of joint angles in degrees."""
_TARGET: tuple[Field, ...] = (("target", "name"), ("arm", "arm"))


def _in(part: str, field: str) -> Callable[[Any], Any]:
    """Return what reads a field of a part of a row; empty where the row has no such part, as an orientation."""
    return lambda row: getattr(getattr(row, part), field, None)


def _limit(field: str) -> Callable[[Any], float | None]:
    """Return what reads a tolerance."""
    return lambda row: shown_tolerance(getattr(row, field))


_BOUND: Field = ("95 % bound", "within_mm", MM, "mm")
_TOLERANCE: Field = ("tolerance", _limit("tolerance_mm"), "g", "mm")
_ROTATION_TOLERANCE: Field = ("tolerance", _limit("orientation_tolerance_mrad"), "g", "mrad")
_ERRORS: tuple[Field, ...] = (
    ("before", "nominal_mm", MM, "mm"),
    ("after", "compensated_mm", MM, "mm"),
    ("corrected", lambda row: row.final_mm if len(row.rounds_mm) > 1 else None, MM, "mm"),
)
_MET: tuple[Field, ...] = (
    _TOLERANCE,
    ("U", lambda row: row.expanded_mm if row.verdict else None, MM, "mm"),
    ("met", "verdict"),
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
    """Show what is expected at targets with a tolerance, or whose rotation is predicted, and whether it should be met.

    Columns of the flange's rotation, and of the partner's flange seen from the first one, are there where they are
    known.
    """
    rotation, relative = partial(_in, "orientation"), partial(_in, "relative")
    return urgent_rows(
        "Predicted at targets",
        [one for one in result.targets if one.tolerance_mm is not None or one.orientation is not None],
        *_TARGET,
        ("standard uncertainty", "uncertainty_mm", MM, "mm"),
        _BOUND,
        _TOLERANCE,
        ("tolerance met", lambda target: target.refusal or target.verdict),
        ("rotation before", rotation("nominal_mrad"), MM, "mrad"),
        ("standard uncertainty", rotation("uncertainty_mrad"), MM, "mrad"),
        ("95 % bound", rotation("within_mrad"), MM, "mrad"),
        _ROTATION_TOLERANCE,
        ("rotation met", rotation("verdict")),
        ("partner: 95 % bound", relative("within_mm"), MM, "mm"),
        ("met", relative("verdict")),
        ("partner: 95 % bound", relative("within_mrad"), MM, "mrad"),
        ("rotation met", relative("turn_verdict")),
        urgency=_prediction_urgency,
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
        ("tracker sees it", lambda target: {True: "yes", False: "no"}.get(target.visible)),
        urgency=lambda target: target.within_mm or 0.0,
    )


# -- measured ---------------------------------------------------------------------------------------------------------


def measured_targets(verify: VerifyResult, arm: str) -> list[MeasuredTarget]:
    """Return the targets of one arm measured with both commands, in the order of tables and charts."""
    return [one for one in verify.of_arm(arm) if None not in (one.nominal_mm, one.compensated_mm)]


def measured_tables(verify: VerifyResult) -> list[Table]:
    """Show each target with its errors, one table for each arm; then cooperative targets.

    They are numbered as on the axis of the chart beside the table.
    """
    rotation = partial(_in, "orientation")
    arms = [
        table
        for arm in verify.arms
        for table in urgent_rows(
            f"Arm {arm}: each target",
            measured_targets(verify, arm),
            ("target", "name"),
            ("frame", lambda row: "" if row.frame == "base" else row.frame),
            *_ERRORS,
            _BOUND,
            *_MET,
            ("rotation before", rotation("nominal_mrad"), MM, "mrad"),
            ("after", rotation("final_mrad"), MM, "mrad"),
            ("95 % bound", rotation("within_mrad"), MM, "mrad"),
            _ROTATION_TOLERANCE,
            ("U", rotation("expanded_mrad"), MM, "mrad"),
            ("rotation met", rotation("verdict")),
            urgency=lambda row: row.final_mm or 0.0,
            numbered=True,
        )
    ]
    return [*arms, *pair_tables(verify)]


def all_measured_tables(verify: VerifyResult) -> list[Table]:
    """Show the tables of ``show DIR verification``: statistics, then every target."""
    return [*verification_tables(verify), *measured_tables(verify)]


def pair_tables(verify: VerifyResult) -> list[Table]:
    """Show the error of the distance between both SMRs at cooperative targets; empty if there are none.

    With two probes also the partner's flange seen from the first one.
    """
    relative = partial(_in, "relative")
    return urgent_rows(
        "Cooperative targets: error of the distance between both SMRs",
        [pair for pair in verify.pairs if pair.compensated_mm is not None],
        ("target", "name"),
        ("arms", lambda pair: arms_words(pair.arms)),
        ("distance", "wanted_mm", ".3f", "mm"),
        *_ERRORS,
        *_MET,
        ("partner: before", relative("nominal_mm"), MM, "mm"),
        ("after", relative("final_mm"), MM, "mm"),
        ("95 % bound", relative("within_mm"), MM, "mm"),
        ("met", relative("position_verdict")),
        ("partner: before", relative("nominal_mrad"), MM, "mrad"),
        ("after", relative("final_mrad"), MM, "mrad"),
        ("95 % bound", relative("within_mrad"), MM, "mrad"),
        ("rotation met", relative("verdict")),
        numbered=True,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _prediction_urgency(target: TargetCommand) -> float:
    """Return a sort key: refused targets first, then by the bounds as shares of the tolerances."""
    if target.refusal:
        return math.inf
    within_mrad = 0.0 if target.orientation is None else target.orientation.within_mrad
    return max(
        (target.within_mm or target.uncertainty_mm or 0.0) / (target.tolerance_mm or math.inf),
        within_mrad / (target.orientation_tolerance_mrad or math.inf),
    )


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
