"""Ranges that the readings of an arm covered: plausible values of conditions that are not stated, and joint ranges."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cellapp.cell.targets.other_payload import OpenElasticity
from cellapp.cell.targets.working_conditions import conditions_payload
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import MeasurementConditions, TemperatureRecord
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

# -- Measuring noise at any point: with the shape that the tracker states and the size of the readings' scatter -------
#
# A laser tracker measures distances better than directions; both errors grow with the distance. The repeatability of
# the arm is isotropic.


@dataclass(frozen=True)
class MeasuringNoise:
    """Standard uncertainties that the tracker states: a constant [m] and a part proportional to distance [m/m].

    ``along`` and ``across`` are relative to the beam; ``typical`` is their mean square [m^2] over the readings.
    """

    along: tuple[float, float]
    across: tuple[float, float]
    typical: float

    @classmethod
    def of(cls, readings: Readings) -> MeasuringNoise | None:
        """Fit to the covariances that an arm's readings state; None if they state none."""
        stated = readings.covariance_M
        if stated is None or not np.isfinite(stated).all():
            return None
        distance = np.linalg.norm(readings.p_M, axis=1)
        beam = readings.p_M / distance[:, None]
        along = np.einsum("na,nab,nb->n", beam, stated, beam)
        whole = np.trace(stated, axis1=1, axis2=2)
        across = np.sqrt(np.maximum(0.5 * (whole - along), 0.0))
        return cls(_line(distance, np.sqrt(along)), _line(distance, across), float(np.mean(whole)) / 3.0)

    def excess(self, noise_m: float) -> float:
        """Return the variance [m^2] of a coordinate by which readings scatter more than the tracker states.

        It is repeatability or a deficiency of the model: the SMR itself deviates by as much.
        """
        return max(noise_m**2 - self.typical, 0.0)

    def covariance(self, p_M: Array, noise_m: float) -> Array:
        """Return the covariance (n, 3, 3) [m^2] of readings at ``p_M`` (n, 3) [m] with the run's scatter ``noise_m``.

        Scatter beyond what the tracker states is added isotropically.
        """
        distance = np.linalg.norm(p_M, axis=1)
        beam = p_M / distance[:, None]
        along, across = (
            (constant + proportional * distance)[:, None, None] ** 2
            for constant, proportional in (self.along, self.across)
        )
        outer = beam[:, :, None] * beam[:, None]
        stated = along * outer + across * (np.eye(3) - outer)
        excess = self.excess(noise_m)
        if excess == 0.0:
            return np.asarray(stated * (noise_m**2 / self.typical))
        return np.asarray(stated + excess * np.eye(3))


def _line(distance: Array, sigma: Array) -> tuple[float, float]:
    """Fit constant and proportional part of standard uncertainties (n,) [m]; a constant if distances hardly differ."""
    if np.ptp(distance) < 0.1 * distance.mean():
        return float(sigma.mean()), 0.0
    slope, constant = np.polyfit(distance, sigma, 1)
    return float(constant), float(slope)


_MARGIN = np.radians(2.0)
"""Margin [rad] of the joint ranges without extrapolation: model corrections vary over tens of degrees."""

Range = tuple[float, float]


@dataclass(frozen=True, eq=False)
class ConditionRanges:
    """Ranges over the readings of one arm; None for what they do not state.

    Attributes
    ----------
    q : array, shape (2, N), or None
        Lowest and highest joint positions [rad].
    step : array, shape (N,), or None
        Median size of each joint's last motion [rad].
    payload_kg, dwell_s, time_s, air_c : pair or None
    payload_centers_F : array, shape (2, 3)
        Centres of mass of the lightest and of the heaviest payload [m]; NaN for the nominal one.
    joints_c : array, shape (2, N), or None
        Lowest and highest temperature of each joint [degC].
    stops : int
        Number of readings, in the order of measurement.
    record : TemperatureRecord or None
        Temperatures of the whole run, for effects with a time lag.
    noise : MeasuringNoise or None
        Noise that the tracker stated.
    elasticity : OpenElasticity or None
        Plausible elastic behaviour under payloads that no reading had.
    """

    q: Array | None = None
    step: Array | None = None
    payload_kg: Range | None = None
    payload_centers_F: Array = field(default_factory=lambda: np.full((2, 3), np.nan))
    dwell_s: Range | None = None
    time_s: Range | None = None
    air_c: Range | None = None
    joints_c: Array | None = None
    stops: int = 0
    record: TemperatureRecord | None = None
    noise: MeasuringNoise | None = None
    elasticity: OpenElasticity | None = None

    @classmethod
    def of(cls, readings: Readings, arm: ArmModel | None = None) -> ConditionRanges:
        """Return the ranges of an arm's readings; ``elasticity`` only if its model is given."""
        if not len(readings):
            return cls()
        known = measurement_conditions(readings)
        joints_c = known.joints_c
        return cls(
            q=np.stack([readings.q.min(axis=0), readings.q.max(axis=0)]),
            step=None if known.step is None else np.nan_to_num(np.nanmedian(np.abs(known.step), axis=0)),
            payload_kg=_range(known.payload_kg),
            payload_centers_F=_centers_of_ends(known),
            dwell_s=_range(known.dwell_s),
            time_s=_range(known.time_s),
            air_c=_range(known.air_c),
            joints_c=None
            if joints_c is None or not np.isfinite(joints_c).all()
            else np.stack([joints_c.min(axis=0), joints_c.max(axis=0)]),
            stops=len(readings),
            record=known.record,
            noise=MeasuringNoise.of(readings),
            elasticity=None if arm is None else OpenElasticity.of(arm, readings),
        )

    def nearest_loaded(self, arm: ArmModel, q: Array, conditions: MeasurementConditions) -> MeasurementConditions:
        """Return ``conditions`` at ``q`` (n, N) [rad] with the nearest measured payload and its centre of mass.

        Readings without payloads had the arm's usual one. If ``elasticity`` is unknown, the conditions are unchanged.
        """
        if self.elasticity is None:
            return conditions
        low, high = self.payload_kg or (arm.bodies.payload_mass, arm.bodies.payload_mass)
        asked_kg = conditions_payload(conditions, arm.bodies.payload_mass, len(q))
        if bool(np.all((low <= asked_kg) & (asked_kg <= high))):
            return conditions
        center_F = np.tile(np.full(3, np.nan), (len(q), 1))
        if conditions.payload_center_F is not None:
            center_F = conditions.payload_center_F.copy()
        for beyond, its in zip((asked_kg < low, asked_kg > high), self.payload_centers_F, strict=True):
            center_F[beyond] = its
        return replace(conditions, payload_kg=np.clip(asked_kg, low, high), payload_center_F=center_F)

    def nearest_measured(self, q: Array) -> Array:
        """Return the configurations nearest to ``q`` (n, N) [rad] within the joint ranges of readings, plus 2 deg."""
        if self.q is None:
            return q
        return np.clip(q, self.q[0] - _MARGIN, self.q[1] + _MARGIN)


def _centers_of_ends(known: MeasurementConditions) -> Array:
    """Return the centres of mass (2, 3) [m] of the lightest and of the heaviest payload."""
    if known.payload_kg is None or known.payload_center_F is None or not np.isfinite(known.payload_kg).any():
        return np.full((2, 3), np.nan)
    return known.payload_center_F[[np.nanargmin(known.payload_kg), np.nanargmax(known.payload_kg)]]


def _range(values: Array | None) -> Range | None:
    if values is None or not np.isfinite(values).any():
        return None
    return float(np.nanmin(values)), float(np.nanmax(values))
