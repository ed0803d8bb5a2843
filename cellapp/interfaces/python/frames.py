"""Readings, residuals, parameters and targets as pandas data frames. Needs the extra ``pandas``.

Columns are named as in exported CSV files, with the unit at the end of the name. ``frame.attrs["units"]`` maps each
column with a unit to that unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from cellapp.cell.exports.dh_tables import ParameterRow, parameter_rows
from cellapp.cell.targets.records import MeasuredTarget, TargetCommand
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.columns import COLUMNS, Column
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel

try:
    import pandas as pd
except ImportError as error:
    raise ImportError(
        "tables of a result or a run need pandas; install it with: pip install 'cellapp[pandas]'"
    ) from error

_AXES = "xyz"


def readings_frame(measured: Mapping[str, Readings]) -> pd.DataFrame:
    """Return ``dataframes.readings`` of one or more arms by name."""
    given = [
        column
        for column in COLUMNS
        if column.required or any(column.is_given(getattr(arm, column.name)) for arm in measured.values())
    ]
    parts = [_arm_readings(name, arm, given) for name, arm in measured.items()]
    frame = pd.concat(parts, ignore_index=True).sort_values("configuration", kind="stable", ignore_index=True)
    joints = max(arm.joints for arm in measured.values())
    units = {name: column.unit for column in given for name in column.csv_names(joints)}
    return _with_units(frame, units)


def residuals_frame(measured: Mapping[str, Readings], residuals_M: Mapping[str, Array]) -> pd.DataFrame:
    """Return ``dataframes.residuals`` of arms by name, from the vectors (n, 3) [m] of each."""
    parts = []
    for name, arm in measured.items():
        vectors_mm = residuals_M[name] * 1e3
        columns: dict[str, Any] = {"configuration": arm.configuration, "arm": name, "split": arm.split}
        columns |= {f"d{axis}_mm": vectors_mm[:, place] for place, axis in enumerate(_AXES)}
        parts.append(pd.DataFrame({**columns, "residual_mm": np.linalg.norm(vectors_mm, axis=1)}))
    frame = pd.concat(parts, ignore_index=True)
    return _with_units(frame, {name: "mm" for name in frame.columns if name.endswith("_mm")})


def parameters_frame(model: CellModel) -> pd.DataFrame:
    """Return ``dataframes.parameters`` of a model."""
    rows = [
        {"arm": name, **asdict(row)} for name, arm in model.arms.items() for row in parameter_rows(arm, arm.geometry)
    ]
    frame = pd.DataFrame(rows, columns=["arm", *ParameterRow.__dataclass_fields__])
    return frame.astype({"standard_error": np.float64})


def targets_frame(found: Sequence[MeasuredTarget | TargetCommand]) -> pd.DataFrame:
    """Return ``dataframes.targets`` of the records of a result."""
    frame = pd.DataFrame([_target(target) for target in found])
    return _with_units(frame, _units_of_targets(list(frame.columns)))


def _arm_readings(name: str, arm: Readings, given: Sequence[Column]) -> pd.DataFrame:
    table: dict[str, Any] = {}
    for column in given:
        values = getattr(arm, column.name)
        names = column.csv_names(arm.joints)
        if values is None:
            table |= dict.fromkeys(names, None if column.dtype is str else np.nan)
        elif isinstance(values, tuple):
            table[names[0]] = list(values)
        else:
            table |= dict(zip(names, column.matrix(values).T))
    table |= {extra: list(texts) for extra, texts in arm.extras.items()}
    frame = pd.DataFrame(table)
    frame.insert(1, "arm", name)
    return frame


def _target(target: MeasuredTarget | TargetCommand) -> dict[str, Any]:
    row: dict[str, Any] = {"target": target.name, "arm": target.arm, "frame": target.frame}
    row |= _numbered(target.position, [f"{axis}_m" for axis in _AXES])
    row |= _numbered(target.rpy, ["roll_rad", "pitch_rad", "yaw_rad"])
    row["tolerance_mm"] = target.tolerance_mm
    if isinstance(target, MeasuredTarget):
        q = target.q
        row |= {"nominal_mm": target.nominal_mm, "compensated_mm": target.compensated_mm, "final_mm": target.final_mm}
    else:
        q = target.q_compensated
        row |= {"uncertainty_mm": target.uncertainty_mm, "refusal": target.refusal}
        if target.relative is not None:
            row |= {f"relative_{name}": value for name, value in target.relative.model_dump().items()}
    row |= {"within_mm": target.within_mm, "verdict": target.verdict, "note": target.note}
    if target.orientation is not None:
        row["orientation_tolerance_mrad"] = target.orientation_tolerance_mrad
        row |= {f"orientation_{name}": value for name, value in target.orientation.model_dump().items()}
    return row | {f"q{joint}": value for joint, value in enumerate(q or (), start=1)}


def _numbered(values: Sequence[float] | None, names: Sequence[str]) -> dict[str, float | None]:
    return dict(zip(names, values if values is not None else [None] * len(names)))


def _units_of_targets(columns: Sequence[str]) -> dict[str, str]:
    suffixes = {"_mm": "mm", "_m": "m", "_rad": "rad", "_mrad": "mrad"}
    units = {name: unit for name in columns for suffix, unit in suffixes.items() if name.endswith(suffix)}
    return units | {name: "rad" for name in columns if name[0] == "q" and name[1:].isdigit()}


def _with_units(frame: pd.DataFrame, units: Mapping[str, str]) -> pd.DataFrame:
    frame.attrs["units"] = {name: units[name] for name in frame.columns if units.get(name)}
    return frame
