"""One calibrated arm as input of every export, and the parts of its model that a rigid chain cannot represent.

Results of ``export``: the files that were written, and what they cannot hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Arm
from cellapp.ground.results import Record, Result
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.effects.effect import is_unnamed
from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, rotation_vectors
from cellapp.robot.model import ArmModel

POSES = 1000
"""Number of random configurations for stated losses: they give the rms to 2 %."""
NETWORK, UNNAMED = "residual_network", "unnamed"


Space = tuple[Array, MeasurementConditions]
"""Configurations (n, N) [rad] of one arm over which losses are stated, and the conditions there."""


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


def workspace(measured_q: Array, conditions: MeasurementConditions, seed: int) -> Space:
    """Sample random configurations within the joint ranges of ``measured_q`` (n, N) [rad].

    Each gets the conditions (approach, payload, temperatures, other arm) of a randomly chosen reading.
    """
    rng = np.random.default_rng(seed)
    q = rng.uniform(measured_q.min(axis=0), measured_q.max(axis=0), (POSES, measured_q.shape[1]))
    return q, conditions.take(rng.integers(len(measured_q), size=POSES))


def lost_parts(model: ArmModel, space: Space) -> dict[str, PositionLoss]:
    """Return the position error without each effect of a model, and without its network."""
    parts = {
        part: replace(model, effects=tuple(its), network=None)
        for part, its in grouped((UNNAMED if is_unnamed(one.law) else one.slug, one) for one in model.effects).items()
    }
    if model.network is not None:
        parts[NETWORK] = replace(model, effects=())
    return {part: lost_by(model.geometry, only, space) for part, only in parts.items()}


def lost_by(geometry: Geometry, model: ArmModel, space: Space) -> PositionLoss:
    """Return position (and, if measured, flange rotation) errors of a rigid chain that replaces a model."""
    q, conditions = space
    shift = model.predict(q, conditions=conditions) - smr_positions(geometry, q)
    errors = {"mm": np.linalg.norm(shift, axis=1) * 1e3}
    if geometry.probe is not None:
        rotated = flange_poses(geometry, q)[0].swapaxes(1, 2) @ model.flange(q, conditions)[0]
        errors["mrad"] = np.linalg.norm(rotation_vectors(rotated), axis=1) * 1e3
    found = {f"rms_{unit}": float(np.sqrt(np.mean(error**2))) for unit, error in errors.items()}
    return PositionLoss(**found, **{f"max_{unit}": float(error.max()) for unit, error in errors.items()})


def conversion_mm(export: ArmExport, held: Geometry) -> float:
    """Return the largest distance [mm] between SMR positions of ``held``, the chain in a file, and of the model."""
    off = smr_positions(held, export.q) - smr_positions(export.geometry, export.q)
    return float(np.linalg.norm(off, axis=1).max()) * 1e3


def millimetres(vector: Array) -> str:
    """Format a vector [m] in mm for a comment."""
    return ", ".join(f"{1e3 * value:z.6f}" for value in vector.tolist())


def hashed(lines: Sequence[str]) -> str:
    """Format comment lines that begin with ``#``."""
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


class PositionLoss(Record):
    """Position error of the SMR [mm] over the workspace where a part of the model is left out.

    ``rms_mrad`` and ``max_mrad`` are of the flange's rotation, where readings had orientations.
    """

    rms_mm: float
    max_mm: float
    rms_mrad: float | None = None
    max_mrad: float | None = None
    omitted_when_none = frozenset({"rms_mrad", "max_mrad"})

    @property
    def words(self) -> str:
        """As ``0.112 mm rms, 0.310 mm at most``."""
        rotated = ""
        if self.rms_mrad is not None and self.max_mrad is not None:
            rotated = f"; {self.rms_mrad:.3f} mrad rms, {self.max_mrad:.3f} mrad at most"
        return f"{self.rms_mm:.3f} mm rms, {self.max_mm:.3f} mm at most{rotated}"


class ArmFile(Record):
    """One arm in a file of another program.

    Attributes
    ----------
    file : str
    smr_m : three numbers
        SMR centre in the last frame that the file describes [m].
    conversion_mm : float
        Largest distance between SMR positions by the numbers of the file and by the model's geometry.
    lost : mapping
        What the file cannot hold, effect by effect; ``residual_network`` is the network.
    lost_together : PositionLoss or None
        All of that together; None if the model is geometry alone.
    """

    file: str
    smr_m: tuple[float, float, float]
    conversion_mm: float
    lost: Mapping[str, PositionLoss]
    lost_together: PositionLoss | None = None


class CommandFile(Record):
    """The commands of one arm in a file: how many it has, and how many targets have none in it."""

    file: str
    commands: int
    refused: int


class ExportResult(Result, schema="cellapp-export"):
    """``export``: the files that were written.

    ``arms`` maps the arms to their files in ``format``, ``commands`` to files of their commands.
    """

    csv: str | None = None
    readings: Mapping[str, int] | None = None
    recordings: Mapping[Literal["joints", "points"], str] | None = None
    plan: str | None = None
    format: str | None = None
    arms: Mapping[str, ArmFile] | None = None
    commands: Mapping[str, CommandFile] | None = None
    notes: tuple[str, ...] = ()
    omitted_when_none = frozenset({"csv", "readings", "recordings", "plan", "format", "arms", "commands"})
