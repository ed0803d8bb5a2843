"""Compute static compliance (10) from positions under forces: displacement along the force per newton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.estimation.iso9283.characteristics import coverage_of_mean
from cellapp.estimation.iso9283.evaluate import Measured, Measurements
from cellapp.estimation.iso9283.places import ArmProgramme, Place
from cellapp.estimation.iso9283.records import ComplianceCharacteristics, ForceStep
from cellapp.robot.kinematics.transforms import Array, xyz_of

FORCE_DIRECTIONS = tuple(f"{sign}{axis}" for axis in "xyz" for sign in "+-")
"""Directions of the force: along the axes of the arm's base, both ways."""
POSE = "P1"


def force_direction(direction: str) -> Array:
    """Return the unit vector (3,) of a direction in the arm's base frame."""
    return np.asarray((1.0 if direction[0] == "+" else -1.0) * np.eye(3)["xyz".index(direction[1])])


def force_place(arm: ArmProgramme, direction: str, force_n: float) -> Place:
    """Return the place of a measurement under a force; without force, group 0 is before the load, group 1 after it."""
    return Place("compliance", arm.commands, (arm.name,), (POSE,), direction, force_n=force_n)


def compliance_characteristics(
    arm: ArmProgramme, measured: Measurements, base_M: Array
) -> tuple[ComplianceCharacteristics, ...]:
    """Compute static compliance in each measured direction; ``base_M`` (3, 3) is the rotation of the base in M.

    With d_k the displacement along the force under F_k from the position without force, the compliance of a cycle
    is ``sum F_k d_k / sum F_k^2``, the least-squares line through zero. Its uncertainty combines the tracker's
    stated covariance in all these positions and the scatter of the cycles.
    """
    found = []
    for direction in FORCE_DIRECTIONS:
        places = {one.place for one in measured.visits if one.place.test == "compliance"}
        forces = sorted(
            force for force in {one.force_n for one in places} if force and force_place(arm, direction, force) in places
        )
        own = _direction(arm, measured, base_M, direction, forces) if forces else None
        if own is not None:
            found.append(own)
    return tuple(found)


# -- inside -----------------------------------------------------------------------------------------------------------


def _direction(
    arm: ArmProgramme, measured: Measurements, base_M: Array, direction: str, forces: Sequence[float]
) -> ComplianceCharacteristics | None:
    before = _by_cycle(measured.at(force_place(arm, direction, 0.0)))
    after = _by_cycle(measured.at(force_place(arm, direction, 0.0), group=1))
    under = [_by_cycle(measured.at(force_place(arm, direction, force))) for force in forces]
    cycles = sorted(set(before).intersection(after, *under))
    if not cycles:
        return None
    name, along_M, F = arm.name, base_M @ force_direction(direction), np.array(forces)
    moved = np.array([[own[c].p_M[name] - before[c].p_M[name] for own in under] for c in cycles])  # (n, k, 3)
    found = (moved @ along_M) @ F / (F @ F)
    left = np.array([(after[c].p_M[name] - before[c].p_M[name]) @ along_M for c in cycles])
    sigma = float(np.sqrt(along_M @ before[cycles[0]].covariance_M[name] @ along_M))
    tracker = sigma * float(np.sqrt(F @ F + F.sum() ** 2)) / float(F @ F)
    n = len(cycles)
    scatter = float(found.std(ddof=1)) * coverage_of_mean(n) if n > 1 else 0.0
    steps = tuple(
        ForceStep(force_n=float(force), displacement_mm=xyz_of(1e3 * one @ base_M))
        for force, one in zip(forces, moved.mean(axis=0), strict=True)
    )
    return ComplianceCharacteristics(
        pose=POSE,
        direction=direction,
        compliance_um_n=1e6 * float(found.mean()),
        expanded_um_n=1e6 * float(np.hypot(2.0 * tracker, scatter)),
        left_mm=1e3 * float(left.mean()),
        steps=steps,
        n=n,
    )


def _by_cycle(visits: Sequence[Measured]) -> dict[int, Measured]:
    return {one.cycle: one for one in visits}
