"""Compute an arm's commands for the poses of its cube: from the published geometry, or from the calibrated model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.driving.iso9283.alignment import Alignment
from cellapp.cell.driving.iso9283.chosen_cube import ChosenCube
from cellapp.cell.driving.iso9283.programme import legs
from cellapp.cell.targets.invert import LARGEST_CORRECTION, invert, with_approach
from cellapp.cell.targets.working_conditions import beside
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.places import ArmProgramme
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, apply, rotation_from_vector
from cellapp.robot.model import CellModel


def arm_programme(
    model: CellModel,
    name: str,
    cube: ChosenCube,
    commands: IsoCommands,
    homes: Mapping[str, Array],
    *,
    rested_s: float,
    payload_kg: float,
    alignment: Alignment | None = None,
) -> ArmProgramme | str:
    """Return the commands of one arm for all positions of the tests, or why the model cannot command them.

    Calibrated commands assume that the arm has rested for ``rested_s`` [s] and came from the position before, with the
    other arm of a pair at home.
    """
    arm, names = model.arms[name], list(cube.q)
    position_B, q = np.array([cube.position_B[one] for one in names]), np.array([cube.q[one] for one in names])
    if commands == "nominal":
        wanted_M = apply(arm.nominal.T_M_B(), position_B)
        at = dict(zip(names, q, strict=True))
        sent = {(position, before): at[position] for position, before in legs()}
    else:
        T_M_B = arm.geometry.T_M_B()
        wanted_M = apply(T_M_B, position_B)
        rotation_M = np.broadcast_to(T_M_B[:3, :3] @ cube.rotation_B, (len(names), 3, 3))
        conditions = _conditions(model, name, homes, len(names), rested_s, payload_kg)
        found = invert(arm, wanted_M, rotation_M, q, conditions)
        if not (found.reached & (np.abs(found.q - q).max(axis=1) <= LARGEST_CORRECTION)).all():
            missed = int(np.argmin(found.reached))
            return f"the calibrated model does not reach {names[missed]} near the nominal joint positions"
        at = dict(zip(names, found.q, strict=True))
        row = conditions.take(np.array([0]))
        sent = {(position, before): with_approach(arm, at[position], at[before], row) for position, before in legs()}
    frame = np.zeros((len(names), 3, 3)) if alignment is None else alignment.position_covariance(q)
    return ArmProgramme(
        name=name,
        commands=commands,
        position_M=dict(zip(names, wanted_M, strict=True)),
        frame=dict(zip(names, frame, strict=True)),
        q=sent,
        rotation_M=_wanted_orientations(arm.nominal if commands == "nominal" else arm.geometry, cube, names),
    )


def _wanted_orientations(geometry: Geometry, cube: ChosenCube, names: Sequence[str]) -> dict[str, Array]:
    """Return the wanted orientation (3, 3) of the probe at each position, the same at all; empty without a probe."""
    if geometry.probe is None:
        return {}
    R_M_S = geometry.T_M_B()[:3, :3] @ cube.rotation_B @ rotation_from_vector(geometry.probe)
    return dict.fromkeys(names, R_M_S)


def _conditions(
    model: CellModel, name: str, homes: Mapping[str, Array], n: int, rested_s: float, payload_kg: float
) -> MeasurementConditions:
    """Return conditions of n commands: payload, rest until mid-measurement, the other arm of a pair at home."""
    stated = MeasurementConditions(payload_kg=np.full(n, payload_kg), dwell_s=np.full(n, rested_s))
    others = [other for other in model.arms if other != name]
    if len(others) != 1:
        return stated
    return beside(stated, model.arms[others[0]], np.tile(homes[others[0]], (n, 1)), None)
