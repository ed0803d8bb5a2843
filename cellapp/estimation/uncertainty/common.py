"""Divide the uncertainty of a TCP into what is common to all its targets and what is each target's own.

Samples of the posterior displace the TCP and turn the flange at every configuration. What is the same everywhere in the
flange frame, as an error of the TCP, and what is one rigid motion of the base, is found by least squares over the
configurations of the readings; it moves all targets together. What is left at a target is its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.uncertainty.records import CommonUncertainty, Six
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import flange_poses
from cellapp.robot.kinematics.transforms import Array, rotation_vectors, twist_columns, xyz_of
from cellapp.robot.model import ArmModel
from cellapp.robot.model.model import PosteriorSamples

MOST_CONFIGURATIONS = 200
"""Largest number of readings whose configurations decide what is common."""
_LENGTH_95 = 2.8
"""Length of a normal vector that 95 % are below, in standard deviations of a coordinate."""
_CHI2_95 = {9: 16.9, 6: 12.6}
"""Value that 95 % of chi-squared variables are below, by their number of degrees of freedom."""
_LEAST = 1e-6
"""Least uncertainty of what is common [m, rad]: a model does not state all of it."""


@dataclass(frozen=True, eq=False)
class Divided:
    """Standard uncertainties of n targets of one TCP.

    Attributes
    ----------
    whole_m, own_m : array, shape (n,)
        Of a coordinate of the TCP, with and without what is common [m].
    whole_rad, own_rad : array, shape (n,)
        Of the flange's rotation, the rms angle [rad].
    common : CommonUncertainty
        What is common, for a result; significant if what is common to the corrections is, against it.
    own_significant : bool
        Whether the own part of some correction is significant against the target's own uncertainty.
    """

    whole_m: Array
    own_m: Array
    whole_rad: Array
    own_rad: Array
    common: CommonUncertainty
    own_significant: bool


def divided(
    arm: ArmModel,
    q: Array,
    tcp: Array,
    conditions: MeasurementConditions,
    measured: Array,
    correction: Callable[[Array, MeasurementConditions], tuple[Array, Array]] | None = None,
    stated: Six | None = None,
) -> Divided | None:
    """Divide the uncertainty of the point ``tcp`` (3,) on the flange at ``q`` (n, N); None if the model states none.

    ``conditions`` are those of the targets; ``measured`` (m, N) are the configurations of the readings; ``correction``
    returns shift [m] and rotation [rad] of the TCP, each (k, 3), at any configurations; none if None. ``stated`` is
    the TCP as a result states it.
    """
    if arm.posterior is None:
        return None
    known, at_tcp = measured[:: max(1, len(measured) // MOST_CONFIGURATIONS)], _with_tcp(arm, arm.posterior, tcp)
    usual = MeasurementConditions(
        payload_kg=None if conditions.payload_kg is None else np.full(len(known), conditions.payload_kg[0])
    )
    moved, rotated = ([samples(at_tcp, known, usual), samples(at_tcp, q, conditions)] for samples in (_moved, _rotated))
    judge = correction or _nothing
    corrected = judge(known, usual), judge(q, conditions)
    shifts, rotations = ([its[part][None] for its in corrected] for part in (0, 1))
    (there, _), (here, origins) = flange_poses(arm.geometry, known), flange_poses(arm.geometry, q)
    centre = (origins + here @ tcp).mean(axis=0)
    columns = [_columns(at_tcp, one, centre) for one in (known, q)]
    rigid, own = _common(columns, moved)
    rigid_shift, own_shift = _common(columns, shifts)
    columns = [_with_identity(there), _with_identity(here)]
    angles, own_rotations = _common(columns, rotated)
    common_rotation, own_rotation = _common(columns, rotations)
    of_network = 0.0 if arm.network is None else np.mean(arm.network.spread(q) ** 2, axis=1)
    own_m, whole_m = (np.sqrt(np.mean(one**2, axis=(0, 2)) + of_network) for one in (own, moved[1]))
    own_rad, whole_rad = (np.sqrt(np.mean(np.sum(one**2, axis=2), axis=0)) for one in (own_rotations, rotated[1]))
    common = _beyond(rigid_shift, rigid) or _beyond(common_rotation, angles)
    shift, rotation = (np.linalg.norm(one[0], axis=1) for one in (own_shift, own_rotation))
    sigma, sigma_rad = (np.sqrt(np.mean(one**2, axis=1)) for one in (rigid, angles))
    found = CommonUncertainty(
        tcp=stated,
        flange_mm=xyz_of(sigma[:3] * 1e3),
        flange_mrad=xyz_of(sigma_rad[:3] * 1e3),
        base_mm=float(np.sqrt(np.mean(sigma[3:6] ** 2))) * 1e3,
        base_mrad=float(np.sqrt(np.sum(sigma_rad[3:] ** 2))) * 1e3,
        own_mm=float(np.median(own_m)) * 1e3,
        significant=None if correction is None else common,
    )
    return Divided(whole_m, own_m, whole_rad, own_rad, found, bool(beyond(shift, rotation, own_m, own_rad).any()))


def _with_tcp(arm: ArmModel, posterior: PosteriorSamples, tcp: Array) -> ArmModel:
    """Return the arm with the TCP in place of the SMR; samples of the SMR's offset do not move another TCP."""
    of_tool = np.array(posterior.columns) >= 6 + 5 * arm.geometry.joints
    of_tool &= not np.array_equal(tcp, arm.geometry.tool)
    posterior = replace(posterior, geometry=np.where(of_tool, 0.0, posterior.geometry))
    return replace(arm, geometry=replace(arm.geometry, tool=tcp), posterior=posterior)


def _nothing(q: Array, conditions: MeasurementConditions) -> tuple[Array, Array]:
    return np.zeros((len(q), 3)), np.zeros((len(q), 3))


def _moved(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> Array:
    """Return the displacements (S, n, 3) of the TCP by each sample [m]."""
    assert arm.posterior is not None
    return arm.posterior.displacements(arm.geometry, arm.effects, arm.context(q, conditions=conditions))


def _rotated(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> Array:
    """Return the rotations (S, n, 3) of the flange by the geometry of each sample [rad]."""
    assert arm.posterior is not None
    columns = list(arm.posterior.columns)
    own = flange_poses(arm.geometry, q)[0].transpose(0, 2, 1)
    found = []
    for sample in arm.posterior.geometry:
        vector = arm.geometry.vector()
        vector[columns] += sample
        found.append(rotation_vectors(flange_poses(arm.geometry.with_vector(vector), q)[0] @ own))
    return np.array(found)


def _columns(arm: ArmModel, q: Array, centre: Array) -> Array:
    """Return how (n, 3, 9) a shift in the flange frame and a rigid motion about ``centre`` displace the TCP."""
    rotations, origins = flange_poses(arm.geometry, q)
    points = origins + rotations @ arm.geometry.tool
    return np.concatenate([rotations, twist_columns(points - centre)], axis=2)


def _with_identity(rotations: Array) -> Array:
    return np.concatenate([rotations, np.broadcast_to(np.eye(3), rotations.shape)], axis=2)


def beyond(shift: Array, rotation: Array, own: Array, own_rotation: Array) -> NDArray[np.bool_]:
    """Return where lengths (n,) of shifts and rotations are significant against standard uncertainties, as those of
    ``Divided``."""
    return np.asarray((shift > _LENGTH_95 * own) | (rotation > _LENGTH_95 / np.sqrt(3.0) * own_rotation))


def _beyond(values: Array, samples: Array) -> bool:
    """Return whether values (k, 1) are not a likely one of the samples (k, S) about zero."""
    covariance = samples @ samples.T / samples.shape[1] + _LEAST**2 * np.eye(len(samples))
    distance = float(values[:, 0] @ np.linalg.solve(covariance, values[:, 0]))
    return distance > _CHI2_95[len(values)]


def _common(columns: list[Array], samples: list[Array]) -> tuple[Array, Array]:
    """Return the common part (k, S) by the readings' configurations, and what is left (S, n, 3) at the targets."""
    (known, here), (of_known, of_here) = columns, samples
    wanted = of_known.reshape(len(of_known), -1).T
    common = np.asarray(np.linalg.lstsq(known.reshape(-1, known.shape[2]), wanted, rcond=None)[0], dtype=np.float64)
    return common, np.asarray(of_here - np.einsum("nck,ks->snc", here, common))
