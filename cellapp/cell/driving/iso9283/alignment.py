"""Fit base and SMR of an arm in the tracker frame to a few measured positions, with the published geometry.

Without a calibration the position of the arm's base frame is unknown, so that accuracy relative to it cannot be stated.
The six parameters of the base and the three of the SMR's offset are fitted to positions that are not poses of the test.
Errors of the published geometry remain in the residuals, from which the covariance of the fit is estimated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.safety.gate import CellBodies
from cellapp.cell.targets.invert import admissible_configurations
from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.calibration.quantities import with_probe
from cellapp.estimation.discovery.plan_forecast import nominal_model
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, parameter_names
from cellapp.robot.kinematics.transforms import Array, rotations_of
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import nominal_arm
from drivers.trackers.protocol import Point

ALIGNMENT_POSITIONS = 20
"""Number of measured positions: sixty coordinates for nine parameters."""
FEWEST_POSITIONS = 6
_KNOWN_BEFORE = 1e-4
"""Prior information relative to the best of one position: it keeps the criterion finite before the first one."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of the fit for one arm.

    Attributes
    ----------
    arm : ArmModel
        The published chain with the fitted base and SMR offset; it has no other model.
    columns : tuple of int
        Indices of the fitted parameters in ``parameter_names``.
    covariance : array, shape (9, 9)
    rms_m : float
        Root mean square distance of the measured from the fitted positions [m].
    n : int
        Number of positions.
    """

    arm: ArmModel
    columns: tuple[int, ...]
    covariance: Array
    rms_m: float
    n: int

    def position_covariance(self, q: Array) -> Array:
        """Return the fit's covariance (n, 3, 3) [m^2] of positions commanded with ``q`` (n, N) [rad]."""
        _, J = jacobian(self.arm.geometry, JointAngles.of(q), self.columns)
        return np.asarray(np.einsum("akn,kl,bln->nab", J, self.covariance, J))


def published_cell(profile: Profile, found: Mapping[str, Alignment]) -> CellModel:
    """Return the published chains, with fitted bases and SMRs if ``found``, else as the profile states them.

    Raise ``InputError`` if the profile does not state where arms and tracker are, or an arm has no home position.
    """
    return CellModel(
        {name: found[name].arm if name in found else nominal_model(profile, name) for name in profile.arms}
    )


def base_and_tool(joints: int) -> tuple[int, ...]:
    """Return the indices of the fitted parameters, rotations of the base first."""
    count = len(parameter_names(joints))
    return (*range(3, 6), *range(3), *range(count - 3, count))


def alignment_configurations(
    cell: CellBodies, homes: Mapping[str, Array], name: str, geometry: Geometry, seed: int
) -> Array:
    """Choose configurations (n, N) [rad] with most information about base and SMR, the other arms at home.

    Candidates are clear and visible. Selection is greedy by the determinant of the information matrix (D-optimal).
    """
    liked = admissible_configurations(cell, homes, name, seed)
    if not len(liked):
        return liked
    _, J = jacobian(geometry, JointAngles.of(liked), base_and_tool(geometry.joints))
    J = J.transpose(2, 0, 1)
    scale = np.sqrt(np.einsum("nak,nak->k", J, J) / len(J))
    J = J / np.where(scale > 0.0, scale, 1.0)
    information = _KNOWN_BEFORE * np.eye(J.shape[2])
    left = np.ones(len(liked), dtype=bool)
    chosen: list[int] = []
    while len(chosen) < min(ALIGNMENT_POSITIONS, len(liked)):
        gain = np.linalg.slogdet(np.eye(3) + J @ np.linalg.solve(information, J.transpose(0, 2, 1)))[1]
        best = int(np.argmax(np.where(left, gain, -np.inf)))
        chosen.append(best)
        left[best] = False
        information = information + J[best].T @ J[best]
    return np.asarray(liked[chosen])


def align_points(profile: Profile, name: str, q: Array, points: Sequence[Point]) -> Alignment:
    """Call ``align`` with measured points, including their orientations if measured."""
    R_M_S = None
    if any(one.quaternion_M is not None for one in points):
        R_M_S = rotations_of([np.full(4, np.nan) if one.quaternion_M is None else one.quaternion_M for one in points])
    return align(profile, name, q, np.array([one.p_M for one in points]).reshape(-1, 3), R_M_S)


def align(profile: Profile, name: str, q: Array, p_M: Array, R_M_S: Array | None = None) -> Alignment:
    """Fit base and SMR offset of an arm to positions ``p_M`` (n, 3) [m] at ``q`` (n, N) [rad].

    The rotation of a probe on the flange is the mean of its orientations ``R_M_S`` (n, 3, 3) relative to the fit.
    Raise ``InputError`` for fewer than six positions.
    """
    if len(q) < FEWEST_POSITIONS:
        raise InputError(
            f"iso9283: arm {name}: {counted(len(q), 'position was', 'positions were')} measured to find its base"
            f" and SMR, at least {FEWEST_POSITIONS} are needed; look for a covered SMR, or calibrate the cell first"
        )
    arm = profile.arms[name]
    start = start_from_nominal(nominal_arm(arm), q, p_M, tool_unknown=arm.smr.offset == "unknown")
    columns = base_and_tool(start.joints)
    found = identify(start, q, p_M, parameter_set=ParameterSet("base and SMR", start.joints, columns))
    found = found.settled(f"fit of the base and SMR of arm {name}")
    geometry = with_probe(found.geometry, q, R_M_S)
    model = replace(nominal_model(profile, name), geometry=geometry, nominal=geometry)
    rms_m = float(np.sqrt(np.mean(np.sum(found.residuals**2, axis=1))))
    return Alignment(model, columns, found.estimated_covariance, rms_m, len(q))
