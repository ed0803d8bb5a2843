"""A list of targets with what a run says about each: the table of the screen Targets, and one target in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

from cellapp.compensation.targets import Target, same_target
from cellapp.reporting.table import Cell, Column, Table, number_column
from cellapp.results import CALIBRATE, DISCOVER, MeasuredTarget, RunResults, TargetCommand, TargetRecord

R = TypeVar("R", bound=TargetRecord)

_COLUMNS = (
    Column("target"),
    Column("arm"),
    number_column("tol.", "g", "mm"),
    Column("state"),
    Column("measured", unit="mm"),
    *(number_column(axis, ".1f", "mm") for axis in ("x", "y", "z")),
    *(number_column(angle, ".2f", "°") for angle in ("roll", "pitch", "yaw")),
)
COLUMN_GROUPS = (5, 8, 11)
"""How many columns a narrow place can show without parting a position or a rotation."""


def target_list(targets: Sequence[Target], results: RunResults | None) -> Table:
    """Each target with its state. A result is shown while the target is as it was when the result was made."""
    return Table("Targets", _COLUMNS, tuple(_row(target, results) for target in targets))


def target_words(target: Target, results: RunResults | None) -> str:
    """Where one target is, and what the run says about it."""
    x, y, z = (f"{value * 1e3:.1f}" for value in target.position)
    rotation = "any rotation"
    if target.rpy is not None:
        rotation = "roll {:.2f}, pitch {:.2f}, yaw {:.2f} deg".format(*(math.degrees(angle) for angle in target.rpy))
    return f"{_result_words(target, results)}\nx {x}, y {y}, z {z} mm; {rotation}"


def _result_words(target: Target, results: RunResults | None) -> str:
    command, measured = _command(target, results), _measured(target, results)
    if command is None and measured is None:
        return f"{target.name}: not compensated yet as it is now."
    words = []
    if command is not None and command.refusal:
        words.append(f"refused: {command.refusal}")
    elif command is not None and command.uncertainty_mm is None:
        words.append("compensated; the model states no uncertainty")
    elif command is not None:
        words.append(f"compensated; standard uncertainty of a coordinate {command.uncertainty_mm:.4f} mm")
    if command is not None and command.verdict:
        words.append(f"tolerance {target.tolerance_mm:g} mm predicted: {command.verdict}")
    if measured is not None and measured.compensated_mm is not None:
        before = "" if measured.nominal_mm is None else f", {measured.nominal_mm:.4f} mm without compensation"
        words.append(f"measured {measured.compensated_mm:.4f} mm from the target{before}")
    if measured is not None and measured.verdict:
        words.append(f"{measured.verdict} of tolerance" if measured.verdict == "out" else "within tolerance")
    if measured is not None and measured.note and not (command is not None and command.refusal):
        words.append(measured.note)
    return f"{target.name}: {'; '.join(words)}."


def stale_model(results: RunResults) -> str:
    """Why the model in force should not be used as it is; empty if it holds."""
    outdated = [name for name in (CALIBRATE, DISCOVER) if name in results.out_of_date]
    return "; ".join(f"'{name}' is out of date ({results.out_of_date[name]})" for name in outdated)


def _row(target: Target, results: RunResults | None) -> tuple[Cell, ...]:
    measured = _measured(target, results)
    errors = ""
    if measured is not None and measured.compensated_mm is not None:
        before = "" if measured.nominal_mm is None else f"{measured.nominal_mm:.3f} -> "
        errors = f"{before}{measured.compensated_mm:.3f}"
    degrees = (None, None, None) if target.rpy is None else [math.degrees(angle) for angle in target.rpy]
    state = _state(_command(target, results), measured)
    return (
        target.name,
        target.arm,
        None if target.tolerance_mm is None else round(target.tolerance_mm, 6),
        state,
        errors,
        *(value * 1e3 for value in target.position),
        *degrees,
    )


def _state(command: TargetCommand | None, measured: MeasuredTarget | None) -> str:
    """The verdict, or why there is none."""
    if command is not None and command.refusal:
        return command.refusal
    if measured is not None and (measured.note or measured.verdict):
        return measured.note or f"{measured.verdict}, measured"
    if command is not None and command.verdict:
        return f"{command.verdict}, predicted"
    if measured is not None:
        return "reached" if measured.compensated_mm is None else "measured"
    return "" if command is None else "compensated"


def _command(target: Target, results: RunResults | None) -> TargetCommand | None:
    compensate = None if results is None else results.compensate
    return None if compensate is None else _about(target, compensate.targets)


def _measured(target: Target, results: RunResults | None) -> MeasuredTarget | None:
    """The last measurement; else the last motion to it."""
    for pushed in () if results is None else (results.verify, results.push):
        found = None if pushed is None else _about(target, pushed.targets)
        if found is not None:
            return found
    return None


def _about(target: Target, stored: Sequence[R]) -> R | None:
    return next((entry for entry in stored if same_target(target, entry)), None)
