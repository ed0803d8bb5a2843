"""Positions and orientations measured with an arm, as one list of vectors with covariances.

A 6-D probe measures a position and an orientation at a stop. The estimation treats them as two readings of three values
each, which share the joint positions and all conditions of the stop: the position [m], and the rotation vector from the
measured to the computed orientation [rad], whose measured value is zero. A model predicts both, with derivatives.
Whitening, robust weights, folds, residuals and effects work alike for both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.records import Repeatability
from cellapp.estimation.readings import Readings, covariances_of, stated_uncertainty
from cellapp.estimation.readings.readings import repeats
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import ErrorSummary, StageErrors
from cellapp.robot.effects import MeasurementConditions, TemperatureRecord
from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.statics import base_moment
from cellapp.robot.kinematics.transforms import (
    Array,
    angular_rows,
    apply,
    mean_rotation,
    quaternions_of,
    rotation_vectors,
    rotations_of,
)
from cellapp.robot.model import ArmModel, CellModel

NOT_STATED = 1e-8
"""Standard uncertainty [m, rad] of a kind that states none while the other does: all of its scatter is estimated."""
_ODD_RAD = 0.2
"""Median angle between orientations and the arm from which they are refused: they belong to another frame."""
SUSPECT_RAD = 0.02
"""Median angle from which other frames are tried: a published arm is off by some mrad."""
_BETTER = 0.2
"""Share of the median angle below which another frame is the one that was meant."""
FEWEST_ROTATIONS = 4
"""Least number of orientations from which their frame is judged."""


@dataclass(frozen=True, eq=False)
class Quantities:
    """Measured vectors of one arm: positions of all n readings, then the orientations that were measured.

    Attributes
    ----------
    reading : array, shape (m,)
        Index of each vector's reading.
    readings : Readings
        m rows; ``p_M`` is zero at orientations.
    conditions : MeasurementConditions
        m rows, with the measured orientations.
    stated : array, shape (m,) or (m, 3, 3), or None
        Stated uncertainty, [m, m^2] or [rad, rad^2].
    sigma : array, shape (m,) or (m, 3, 3)
        Uncertainty that weights them: 1 until a fit sets it.
    """

    reading: NDArray[np.intp]
    readings: Readings
    conditions: MeasurementConditions
    stated: Array | None
    sigma: Array

    def __len__(self) -> int:
        return len(self.readings)

    @property
    def R_M_S(self) -> Array | None:
        """Measured orientations (m, 3, 3), NaN at positions; None if none was measured."""
        return self.conditions.R_M_S

    @property
    def angular(self) -> NDArray[np.bool_] | None:
        """Mask (m,) of the vectors that are orientations; None if none is."""
        return self.conditions.angular

    @property
    def points(self) -> NDArray[np.bool_]:
        """Mask (m,) of the vectors that are positions."""
        return np.ones(len(self), dtype=np.bool_) if self.angular is None else ~self.angular

    @property
    def positions(self) -> Self:
        """The vectors that are positions."""
        if self.angular is None:
            return self
        its = self.take(self.points)
        return replace(its, conditions=replace(its.conditions, R_M_S=None))

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """Return some of the vectors."""
        return replace(
            self,
            reading=self.reading[rows],
            readings=self.readings.take(rows),
            conditions=self.conditions.take(rows),
            stated=None if self.stated is None else self.stated[rows],
            sigma=self.sigma[rows],
        )

    def chunks(self, most: int) -> Iterator[Self]:
        """Yield the vectors in parts of at most ``most``."""
        for first in range(0, len(self), most):
            yield self.take(np.arange(first, min(first + most, len(self)), dtype=np.intp))

    def predicted(self, model: ArmModel) -> Array:
        """Return predicted positions (m, 3) [m], and rotations from measured to computed orientations [rad]."""
        return model.predict(self.readings.q, self.conditions)

    def residuals(self, model: ArmModel) -> Array:
        """Return measured less predicted positions (m, 3) [m], and rotations from computed to measured [rad]."""
        return np.asarray(self.readings.p_M - self.predicted(model))

    def off(self, geometry: Geometry) -> Array:
        """Return the same by a geometry alone."""
        return np.asarray(self.readings.p_M - smr_positions(geometry, self.readings.q, self.R_M_S))

    def readings_with(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask (n,) of the readings that have at least one of the ``chosen`` (m,) vectors."""
        n = len(self.reading) if self.angular is None else int(np.count_nonzero(~self.angular))
        return np.isin(np.arange(n), self.reading[chosen])


def measured_orientations(readings: Readings) -> tuple[NDArray[np.intp], Array]:
    """Return the rows (k,) with a measured orientation, and the probe's rotations (k, 3, 3) in the tracker frame."""
    if readings.quaternion_M is None:
        return np.zeros(0, dtype=np.intp), np.zeros((0, 3, 3))
    rows = np.flatnonzero(np.isfinite(readings.quaternion_M).all(axis=1)).astype(np.intp)
    return rows, rotations_of(readings.quaternion_M[rows])


def measured_quantities(readings: Readings, conditions: MeasurementConditions | None = None) -> Quantities:
    """Return positions and orientations of some readings; the readings unchanged if there are positions only."""
    conditions = MeasurementConditions() if conditions is None else conditions
    n, stated = len(readings), stated_uncertainty(readings)
    rows, rotations = measured_orientations(readings)
    every = np.arange(n, dtype=np.intp)
    if not len(rows):
        return Quantities(every, readings, conditions, stated, np.ones(n))
    both = np.concatenate([every, rows])
    R_M_S: Array = np.full((len(both), 3, 3), np.nan)
    R_M_S[n:] = rotations
    p_M = readings.p_M[both].copy()
    p_M[n:] = 0.0
    whole = replace(readings.take(both), p_M=p_M)
    conditions = replace(conditions.take(both), R_M_S=R_M_S)
    return Quantities(both, whole, conditions, _stated(readings, stated, rows), np.ones(len(both)))


def _stated(readings: Readings, of_points: Array | None, rows: NDArray[np.intp]) -> Array:
    """Return the uncertainty of positions and orientations, ``NOT_STATED`` for a kind that states none."""
    of_rotations = np.full(len(rows), NOT_STATED)
    if readings.sigma_rad is not None and np.isfinite(readings.sigma_rad[rows]).all():
        of_rotations = readings.sigma_rad[rows]
    if readings.rotation_covariance_M is not None:
        of_rotations = readings.rotation_covariance_M[rows]
    if of_points is None:
        of_points = np.full(len(readings), NOT_STATED)
    if of_points.ndim == of_rotations.ndim:
        return np.concatenate([of_points, of_rotations])
    return np.concatenate([covariances_of(of_points), covariances_of(of_rotations)])


def states_nothing(stated: Array) -> bool:
    """Return whether ``stated``, (n,) or (n, 3, 3), stands for a kind of quantity without stated uncertainty."""
    return float(stated.max()) <= (NOT_STATED if stated.ndim == 1 else NOT_STATED**2)


def with_probe(geometry: Geometry, q: Array, R_M_S: Array | None) -> Geometry:
    """Set the probe's rotation to the mean over the orientations (m, 3, 3) at ``q`` (m, N) [rad]; skip NaN rows.

    Without orientations, return the arm without a probe.
    """
    if R_M_S is None:
        return replace(geometry, probe=None)
    angular = angular_rows(R_M_S)
    R_M_F, _ = flange_poses(geometry, q[angular])
    rotation = mean_rotation(R_M_F.swapaxes(1, 2) @ R_M_S[angular])
    return replace(geometry, probe=rotation_vectors(rotation[None])[0])


def refuse_odd_orientations(name: str, geometry: Geometry, readings: Readings) -> None:
    """Raise ``InputError`` if the orientations do not follow arm ``name``; it says in which frame they would, or before
    which configuration the probe slipped.

    How the probe is mounted is unknown, but its orientation relative to the flange is the same at all stops.
    """
    rows, rotations = measured_orientations(readings)
    q = readings.q[rows]
    if len(rows) < FEWEST_ROTATIONS or (own := rotation_scatter(geometry, q, rotations)) < SUSPECT_RAD:
        return
    ends = range(FEWEST_ROTATIONS, len(rows) - FEWEST_ROTATIONS + 1)
    parts = {
        end: max(rotation_scatter(geometry, q[part], rotations[part]) for part in (slice(end), slice(end, None)))
        for end in ends
    }
    slip = min(ends, key=lambda end: parts[end], default=0)
    if slip and parts[slip] < _BETTER * own:
        raise InputError(
            f"arm '{name}': the probe slipped in its mount before configuration {readings.configuration[rows[slip]]}:"
            " the orientations until then and from then on follow the flange each for themselves; fasten the probe and"
            " measure again, or import both parts as runs of their own"
        )
    found = {words: rotation_scatter(geometry, q, changed(rotations)) for words, changed in _FRAMES.items()}
    why = min(found, key=lambda words: found[words])
    if found[why] >= _BETTER * own:
        if own < _ODD_RAD:
            return
        why = "they fit in no usual convention: look for quaternions of other rows, another arm or another frame"
    raise InputError(
        f"arm '{name}': the orientations quat_w, ..., quat_z of most readings, the first of them configuration"
        f" {readings.configuration[rows[0]]}, do not rotate with the flange; {why}"
    )


def rotation_scatter(geometry: Geometry, q: Array, rotations: Array) -> float:
    """Compute the median angle [rad] between orientations and the arm with the probe that fits them best."""
    R_F_S = flange_poses(geometry, q)[0].swapaxes(1, 2) @ rotations
    return float(np.median(np.linalg.norm(rotation_vectors(mean_rotation(R_F_S).T @ R_F_S), axis=1)))


def _of_quaternions(order: tuple[int, ...], signs: tuple[float, ...]) -> Callable[[Array], Array]:
    """Return a function that reorders the components (w, x, y, z) of rotations' quaternions and changes their signs."""
    return lambda rotations: rotations_of(quaternions_of(rotations)[:, order] * np.array(signs))


_FRAMES: dict[str, Callable[[Array], Array]] = {
    "they fit as those of the tracker in the probe's frame: give the inverse, quat_x, quat_y and quat_z with the"
    " opposite sign": lambda rotations: np.swapaxes(rotations, 1, 2),
    "they fit with the scalar last: the first column must be quat_w": _of_quaternions((3, 0, 1, 2), (1.0,) * 4),
    **{
        f"they fit in a mirrored frame ({axes}): the probe's or the tracker's frame is left-handed": (
            _of_quaternions((0, 1, 2, 3), (1.0, *signs))
        )
        for axes, signs in {
            "x against y and z": (1.0, -1.0, -1.0),
            "y against x and z": (-1.0, 1.0, -1.0),
            "z against x and y": (-1.0, -1.0, 1.0),
        }.items()
    },
}


# -- Measurement conditions that effects depend on: last steps, other arm, times, temperatures ------------------------

_LEAST_AGREEMENT = 0.95
"""Least share of the logged approach signs that match the steps between successive stops, for these to serve as last
steps. Below it the arms took detours; a few logged signs may be wrong, as controllers report tiny corrections."""


def measurement_conditions(readings: Readings, other: tuple[ArmModel, Readings] | None = None) -> MeasurementConditions:
    """Collect the conditions of one arm's readings; ``other`` is the model and the readings of the other arm, if any.

    Steps that were not logged are derived from the order of the stops in time, if they match the approach signs. The
    other arm's values are NaN at stops where it has no reading.
    """
    time_s = readings.time_s if np.isfinite(readings.time_s).any() else None
    approach = readings.approach if np.any(readings.approach) else None
    moment = other_q = None
    if other is not None and len(other[1]):
        model, theirs = other
        rows = {number: row for row, number in enumerate(theirs.configuration.tolist())}
        match = np.array([rows.get(number, -1) for number in readings.configuration.tolist()], dtype=np.intp)
        at = np.full((len(readings), theirs.joints), np.nan) if readings.other_q is None else readings.other_q.copy()
        at[match >= 0] = theirs.q[match[match >= 0]]
        present = np.isfinite(at).all(axis=1)
        if present.any():
            other_q, payload = at, None
            if theirs.payload_kg is not None:  # stops beside recordings have one load
                payload = np.where(match >= 0, theirs.payload_kg[match], theirs.payload_kg[0])[present]
            moment = np.full((len(readings), 3), np.nan)
            moment[present] = base_moment(model.geometry, model.bodies, at[present], model.up_M, payload)
    return MeasurementConditions(
        approach=approach,
        step=_with_derived_steps(readings.step, _steps(readings)),
        dwell_s=readings.dwell_s,
        time_s=time_s,
        order=_order(readings),
        payload_kg=readings.payload_kg,
        payload_center_F=readings.payload_center_F,
        air_c=readings.temperature_c,
        joints_c=readings.joint_temperature_c,
        other_moment_M=moment,
        other_q=other_q,
        record=_record(readings),
    )


def conditions_of_arms(
    models: Mapping[str, ArmModel], readings: Mapping[str, Readings]
) -> dict[str, MeasurementConditions]:
    """Collect the conditions of every arm's readings; in a cell of two arms, with the other arm's pose and load."""
    found = {}
    for name, own in readings.items():
        others = [other for other in readings if other != name]
        other = (models[others[0]], readings[others[0]]) if len(others) == 1 else None
        found[name] = measurement_conditions(own, other)
    return found


def measured_minus_computed(model: CellModel, readings: Mapping[str, Readings]) -> dict[str, Array]:
    """Compute residuals (n, 3) [m] in frame M of all readings of each arm, in their order and at their conditions."""
    conditions = conditions_of_arms(model.arms, readings)
    return {
        name: np.asarray(
            (arm.p_M if model.T_M_M0 is None else apply(model.T_M_M0, arm.p_M))
            - model.arms[name].predict(arm.q, conditions=conditions[name])
        )
        for name, arm in readings.items()
    }


@dataclass(frozen=True, eq=False)
class ArmReadings:
    """Readings of one arm of a cell with their conditions, and the arm as calibrated with them."""

    profile: Profile
    name: str
    model: ArmModel
    readings: Readings
    conditions: MeasurementConditions

    @classmethod
    def alone(cls, profile: Profile, name: str, model: ArmModel, readings: Readings) -> ArmReadings:
        """Return the readings with the conditions that follow from those of this arm alone."""
        return cls(profile, name, model, readings, measurement_conditions(readings))

    @classmethod
    def of_cell(
        cls, profile: Profile, models: Mapping[str, ArmModel], readings: Mapping[str, Readings]
    ) -> dict[str, ArmReadings]:
        """Return the readings of every arm of ``models``."""
        conditions = conditions_of_arms(models, readings)
        return {name: cls(profile, name, model, readings[name], conditions[name]) for name, model in models.items()}

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> ArmReadings:
        """Return some of the rows."""
        return replace(self, readings=self.readings.take(rows), conditions=self.conditions.take(rows))

    def quantities(self) -> Quantities:
        """Return the measured positions and orientations."""
        return measured_quantities(self.readings, self.conditions)


def _order(readings: Readings) -> Array | None:
    """Return ranks (n,) in the order of measurement [stops], by sequence, else by time; None if that is incomplete."""
    known = readings.time_s if readings.sequence is None else readings.sequence
    if not len(known) or not np.isfinite(known).all():
        return None
    return np.argsort(np.argsort(known, kind="stable")).astype(np.float64)


def _with_derived_steps(logged: Array | None, derived: Array | None) -> Array | None:
    """Fill rows without logged steps with derived ones (readings of a version that did not log steps)."""
    if logged is None or derived is None:
        return derived if logged is None else logged
    return np.where(np.isnan(logged), derived, logged)


def _record(readings: Readings) -> TemperatureRecord | None:
    """Return the temperature history of the run; None unless times and joint temperatures are complete."""
    joints_c, time_s = readings.joint_temperature_c, readings.time_s
    if joints_c is None or not np.isfinite(joints_c).all() or not np.isfinite(time_s).all():
        return None
    air_c = readings.temperature_c
    if air_c is None or not np.isfinite(air_c).all():
        air_c = joints_c.mean(axis=1)
    return TemperatureRecord(time_s, joints_c, air_c)


def _steps(readings: Readings) -> Array | None:
    """Compute steps (n, N) [rad] between successive stops; None if times or approach signs are missing or disagree."""
    if len(readings) < 2 or not np.isfinite(readings.time_s).all() or not np.any(readings.approach):
        return None
    order = np.argsort(readings.time_s, kind="stable")
    steps = np.zeros_like(readings.q)
    steps[order[1:]] = np.diff(readings.q[order], axis=0)
    known = (readings.approach != 0) & (steps != 0.0)
    known[order[0]] = False
    if not known.any() or np.mean(np.sign(steps[known]) == readings.approach[known]) < _LEAST_AGREEMENT:
        return None
    return steps


# -- Error statistics of a model on held-out readings: position errors, ISO 9283 distance errors, repeatability -------

_SAMPLES = 400
"""Number of bootstrap samples: they fix the ends of a 95 % interval to a few per cent of its width."""
_SAME_JOINTS_RAD = 2e-4
"""Joint difference below which two stops are the same: above a controller's repeatability, below any planned step."""


def summarise(errors: Array, means: Array | None = None) -> ErrorSummary:
    """Compute statistics in mm of errors (n,) [m], or in mrad of errors [rad].

    ``means`` (samples,) [m] are bootstrapped means, needed if the errors are not independent.
    """
    mm = np.abs(errors) * 1e3
    if means is None:
        weights = _resampled(len(mm))
        means = weights @ np.abs(errors) / len(mm)
    low, high = (np.quantile(means, [0.025, 0.975]) * 1e3).tolist()
    return summary_mm(mm).model_copy(update={"mean_ci95": (low, high)})


def summary_mm(mm: Array) -> ErrorSummary:
    """Compute statistics of errors [mm] that may be correlated: without a confidence interval of their mean."""
    p50, p95 = np.quantile(mm, [0.5, 0.95]).tolist()
    std = float(mm.std(ddof=1)) if len(mm) > 1 else 0.0
    rms, mean, most = float(np.sqrt(np.mean(mm**2))), float(mm.mean()), float(mm.max())
    return ErrorSummary(mean=mean, rms=rms, std=std, max=most, p50=p50, p95=p95, n=len(mm))


@lru_cache(maxsize=1)
def _resampled(n: int) -> Array:
    """Sample bootstrap weights (samples, n): how often each of n is sampled in each sample; kept for the next stage."""
    return np.random.default_rng(n).multinomial(n, np.full(n, 1.0 / n), size=_SAMPLES).astype(np.float64)


def position_errors(measured: Array, computed: Array) -> Array:
    """Compute the absolute error of each point, ``|P_M - P_C|``, shape (n,) [m]."""
    return np.asarray(np.linalg.norm(measured - computed, axis=1))


def distance_errors(measured: Array, computed: Array) -> Array:
    """Compute the ISO 9283 error ``|d_M - d_C|`` (n (n - 1) / 2,) [m] of every pair of points (n, 3) of one arm."""
    return np.asarray(np.abs(scipy.spatial.distance.pdist(measured) - scipy.spatial.distance.pdist(computed)))


def distance_summary(measured: Array, computed: Array, weights: Array | None = None) -> ErrorSummary:
    """Compute statistics of the distance errors of all pairs; the bootstrap resamples points, as pairs share points.

    ``weights`` are the bootstrap weights of the points; sampled if None.
    """
    errors = distance_errors(measured, computed)
    n = len(measured)
    weights = _resampled(n) if weights is None else weights
    # Single precision is enough for the ends of an interval from 400 samples.
    whole = scipy.spatial.distance.squareform(errors.astype(np.float32))
    total = np.einsum("sn,sn->s", weights.astype(np.float32) @ whole, weights)
    different = weights.sum(axis=1) ** 2 - np.einsum("sn,sn->s", weights, weights)
    means = total / np.maximum(different, 1.0)
    return summarise(errors, means)


def repeatability(q: Array, p_M: Array) -> Repeatability | None:
    """Compute the position repeatability of repeated stops (same joints to 0.2 mrad); None if no stop was repeated.

    ISO 9283: mean distance from the barycentre plus three standard deviations, here over all groups of repeats.
    """
    group = repeats(q, _SAME_JOINTS_RAD)
    sizes = np.bincount(group)
    repeated = sizes[group] > 1
    if not repeated.any():
        return None
    centers = np.stack([np.bincount(group, p_M[:, k]) / sizes for k in range(3)], axis=1)
    off = np.linalg.norm(p_M - centers[group], axis=1)[repeated] * 1e3
    return Repeatability(mean=float(off.mean()), rp=float(off.mean() + 3.0 * off.std(ddof=1)), n=len(off))


def repeats_words(q: Array, p_M: Array) -> str:
    """Say how many configurations rows (n, N) [rad] with points (n, 3) [m] are, and how far repeats scatter; empty
    without repeats."""
    count = len(np.unique(repeats(q)))
    if count == len(q):
        return ""
    found = repeatability(q, p_M)
    scatter = "" if found is None else f", which scatter by {found.mean:.4f} mm in the mean (RP {found.rp:.4f} mm)"
    return (
        f"{counted(count, 'configuration')} and {counted(len(q) - count, 'repeat')}{scatter}: repeats stay on one side"
        " of every split"
    )


def evaluate_quantities(measured: Quantities, computed: Array) -> StageErrors:
    """Compute the errors of one model, ``computed`` (m, 3), at positions [m] and orientations [rad]."""
    p_M, angular = measured.readings.p_M, measured.angular
    if angular is None:
        return evaluate(p_M, computed, measured.readings.q)
    errors = evaluate(p_M[~angular], computed[~angular], measured.readings.q[~angular])
    return errors.model_copy(update={"orientation_mrad": summarise(np.linalg.norm(computed[angular], axis=1))})


def evaluate(measured: Array, computed: Array, q: Array) -> StageErrors:
    """Compute absolute and distance errors of one model at points (n, 3) [m]; a single point has no distance.

    The bootstrap resamples configurations ``q`` (n, N) [rad], each with its repeats.
    """
    group = repeats(q)
    errors, weights = position_errors(measured, computed), _resampled(len(np.unique(group)))[:, group]
    return StageErrors(
        position_mm=summarise(errors, weights @ errors / weights.sum(axis=1)),
        distance_mm=distance_summary(measured, computed, weights) if len(measured) > 1 else None,
    )
