"""One calibrated arm as input of every export, and the parts of its model that a rigid chain cannot represent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.exports.records import PositionLoss
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Arm
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.effects.effect import is_unnamed
from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, rotation_vectors
from cellapp.robot.model import ArmModel

POSES = 1000
"""Number of random configurations for stated losses: they give the rms to 2 %."""
NETWORK, UNNAMED = "residual_network", "unnamed"


@dataclass(frozen=True)
class Workspace:
    """Configurations ``q`` (n, N) [rad] of one arm over which losses are stated, with the conditions there."""

    q: Array
    conditions: MeasurementConditions


@dataclass(frozen=True)
class ArmExport:
    """Calibrated arm to be written for another program.

    Attributes
    ----------
    name : str
    arm : Arm
        Section of the profile: limits and speeds of the joints.
    model : ArmModel
        Model whose geometry is written.
    source : str
        Run, and stage of it, that the model is from.
    q : array, shape (n, N)
        Configurations of the workspace [rad].
    lost : mapping
        Effect (or ``residual_network``) -> position error without it, over ``q``.
    lost_together : PositionLoss or None
        Position error of the geometry alone; None if the model is geometry alone.
    """

    name: str
    arm: Arm
    model: ArmModel
    source: str
    q: Array
    lost: Mapping[str, PositionLoss]
    lost_together: PositionLoss | None

    @property
    def geometry(self) -> Geometry:
        """The identified chain."""
        return self.model.geometry


def workspace(measured_q: Array, conditions: MeasurementConditions, seed: int) -> Workspace:
    """Draw random configurations within the joint ranges of ``measured_q`` (n, N) [rad].

    Each gets the conditions (approach, payload, temperatures, other arm) of a randomly chosen reading.
    """
    rng = np.random.default_rng(seed)
    q = rng.uniform(measured_q.min(axis=0), measured_q.max(axis=0), (POSES, measured_q.shape[1]))
    return Workspace(q, conditions.take(rng.integers(len(measured_q), size=POSES)))


def lost_parts(model: ArmModel, space: Workspace) -> dict[str, PositionLoss]:
    """Return the position error without each effect of a model, and without its network."""
    parts = {
        part: replace(model, effects=tuple(its), network=None)
        for part, its in grouped((UNNAMED if is_unnamed(one.law) else one.slug, one) for one in model.effects).items()
    }
    if model.network is not None:
        parts[NETWORK] = replace(model, effects=())
    return {part: lost_by(model.geometry, only, space) for part, only in parts.items()}


def lost_by(geometry: Geometry, model: ArmModel, space: Workspace) -> PositionLoss:
    """Return position (and, if measured, flange rotation) errors of a rigid chain that replaces a model."""
    shift = model.predict(space.q, conditions=space.conditions) - smr_positions(geometry, space.q)
    errors = {"mm": np.linalg.norm(shift, axis=1) * 1e3}
    if geometry.probe is not None:
        turned = flange_poses(geometry, space.q)[0].swapaxes(1, 2) @ model.flange(space.q, space.conditions)[0]
        errors["mrad"] = np.linalg.norm(rotation_vectors(turned), axis=1) * 1e3
    found = {f"rms_{unit}": float(np.sqrt(np.mean(error**2))) for unit, error in errors.items()}
    return PositionLoss(**found, **{f"max_{unit}": float(error.max()) for unit, error in errors.items()})


def conversion_mm(export: ArmExport, held: Geometry) -> float:
    """Return the largest distance [mm] between SMR positions of ``held``, the chain in a file, and of the model."""
    off = smr_positions(held, export.q) - smr_positions(export.geometry, export.q)
    return float(np.linalg.norm(off, axis=1).max()) * 1e3


def millimetres(vector: Array) -> str:
    """Format a vector [m] in mm for a comment."""
    return ", ".join(f"{1e3 * value:.6f}" for value in vector.tolist())


def hashed(lines: Sequence[str]) -> str:
    """Format comment lines that begin with ``#``."""
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)
