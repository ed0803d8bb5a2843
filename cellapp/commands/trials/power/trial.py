"""One blind trial of a plan: hide an effect of a given size in an arm, measure the planned stops, and search.

The law is one of the simulated cell, of another shape than the library's if there is one. Its SMR displacements are
scaled to the requested size, so that the sizes of all effects are comparable and a law keeps its shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.duration import stop_times_of
from cellapp.cell.planning.planned_stops import PlannedStops, last_motions
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.commands.trials.blind import with_hidden
from cellapp.commands.trials.power.result import NamingTrial
from cellapp.commands.trials.visible_size import beyond_geometry, registered_model
from cellapp.estimation.calibration.calibrate import calibrate_arm, profile_splits
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.records import AcceptedEffect, SmallestSize
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Plant as PlantSection
from cellapp.ground.results import Record
from cellapp.robot.kinematics.transforms import Array, quaternions_of, rotation_vectors
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import OFF_AXIS
from drivers.plant import Plant, suggest_other_law
from drivers.plant.plant import Conditions

_JOINT_RISE_K, _WARM_UP_S = 10.0, 3000.0
"""Final temperature of joints above the air [K], and its time constant [s]."""
_AIR_K, _AIR_PERIOD_S = 1.0, 1.5e4
"""Amplitude [K] and period [s] of the air's temperature."""
_STILL_M = 1e-9
"""An effect of realistic size that moves the SMR by less [m] does not act at these stops."""

Rows = tuple[tuple[float, ...], ...]


class PlannedCell(Record):
    """What all trials share: the profile and its planned stops.

    ``q`` and ``step`` are arm -> joint positions and last motions (n, N) [rad], ``time_s`` and ``dwell_s`` (n,) [s].
    """

    profile: Profile
    q: Mapping[str, Rows]
    step: Mapping[str, Rows]
    time_s: tuple[float, ...]
    dwell_s: tuple[float, ...]

    @classmethod
    def of(cls, profile: Profile, stops: PlannedStops) -> PlannedCell:
        """Return the cell of a profile at the stops of a plan, reserves left out."""
        reserves = profile.plan.reserves(len(stops))
        visited = stops.take([stop for stop in range(len(stops)) if stop not in reserves])
        times = stop_times_of(profile, visited)
        return cls(
            profile=profile,
            q={name: _rows(q) for name, q in visited.q.items()},
            step={name: _rows(step) for name, step in last_motions(visited, home_positions(profile)).items()},
            time_s=tuple(times.measured_s.tolist()),
            dwell_s=tuple(times.resting_s.tolist()),
        )


@dataclass(frozen=True, eq=False)
class TrialCell:
    """A cell whose plan is tried.

    Attributes
    ----------
    profile, simulated : Profile
        The profile for evaluation, and the simulated one: without effects, with masses and geometry of a typical arm.
    conditions : mapping
        Arm -> conditions of its planned stops.
    readings : mapping
        Arm -> readings of the published arm, without noise; each trial replaces their points.
    """

    profile: Profile
    simulated: Profile
    conditions: Mapping[str, Conditions]
    readings: Mapping[str, Readings]

    @cached_property
    def models(self) -> dict[str, ArmModel]:
        """Published arms, registered to their readings: needed for effects that depend on the other arms."""
        return {name: registered_model(self.profile, name, own.q, own.p_M) for name, own in self.readings.items()}

    def noise_rms_m(self, name: str) -> float:
        """Return the rms length of the tracker's noise at the stops of an arm [m]."""
        covariance = self.readings[name].covariance_M
        assert covariance is not None
        return float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))


def trial_cell(planned: PlannedCell) -> TrialCell:
    """Prepare a cell. Raises ``InputError`` if the profile does not give the poses of arms and tracker."""
    simulated = _simulated(planned.profile)
    plant = build_plant(simulated)
    time_s, dwell_s = np.array(planned.time_s), np.array(planned.dwell_s)
    q = {name: np.array(rows) for name, rows in planned.q.items()}
    air_c = plant.config.temperature_c + _AIR_K * np.sin(2.0 * np.pi * time_s / _AIR_PERIOD_S)
    warm_c = air_c - _JOINT_RISE_K * np.expm1(-time_s / _WARM_UP_S)
    conditions: dict[str, Conditions] = {}
    readings: dict[str, Readings] = {}
    for name, own in q.items():
        step = np.array(planned.step[name])
        load = np.full(len(own), planned.profile.arms[name].payload.mass)
        joints_c = np.repeat(warm_c[:, None], own.shape[1], axis=1)
        conditions[name] = {
            "approach": np.sign(step),
            "others": {other: rows for other, rows in q.items() if other != name},
            "time_s": time_s,
            "last_step": step,
            "since_rest_s": dwell_s,
            "payload": load,
            "joints_c": joints_c,
            "air_c": air_c,
        }
        exact = plant.smr_positions(name, own, **conditions[name])
        readings[name] = Readings(
            configuration=np.arange(len(own)),
            time_s=time_s,
            q=own,
            approach=np.sign(step).astype(np.int8),
            p_M=exact,
            payload_kg=load,
            temperature_c=air_c,
            joint_temperature_c=joints_c,
            step=step,
            dwell_s=dwell_s,
            covariance_M=plant.measure_positions(exact, np.random.default_rng(0))[1],
        )
    return TrialCell(planned.profile, simulated, conditions, readings)


def naming_trial(cell: TrialCell, asked: NamingTrial) -> NamingTrial:
    """Hide the effect, measure, calibrate and search; return the trial with the findings."""
    rng = np.random.default_rng([asked.seed, 0xB0E2])
    name = asked.arm
    true_arms = int(rng.integers(2**31))
    plant = build_plant(with_hidden(cell.simulated, {}, true_arms))
    config = next(arm for arm in plant.config.arms if arm.name == name)
    duration_s = float(cell.readings[name].time_s[-1])
    law: Mapping[str, Any] = suggest_other_law(asked.effect, rng, config, duration_s)
    hidden = build_plant(with_hidden(cell.simulated, {name: {asked.effect: law}}, true_arms))
    measured = _measured(cell, name, plant, hidden, 1e-3 * asked.size_mm, rng)
    return asked if measured is None else _searched(cell, asked, *measured)


# -- inside -----------------------------------------------------------------------------------------------------------


def _rows(values: Array) -> Rows:
    return tuple(tuple(row) for row in values.tolist())


def _simulated(profile: Profile) -> Profile:
    """Return the profile with a simulated cell: that of its section ``plant``, or a typical one."""
    plant = (profile.plant or PlantSection()).model_copy(update={"effects": {}, "noise": True})
    arms = {
        name: arm
        if arm.smr.offset != "unknown"
        else arm.model_copy(update={"smr": arm.smr.model_copy(update={"offset": tuple(OFF_AXIS.tolist())})})
        for name, arm in profile.arms.items()
    }
    return profile.model_copy(update={"plant": plant, "arms": arms})


def _measured(
    cell: TrialCell, name: str, plant: Plant, hidden: Plant, size_m: float, rng: np.random.Generator
) -> tuple[Readings, float] | None:
    """Simulate readings of an arm with an effect of a size [m]; also return the share of it that geometry cannot
    absorb.

    None if the effect does not act at these stops.
    """
    own, conditions = cell.readings[name], cell.conditions[name]
    scatter = 0.0 if cell.simulated.plant is None else cell.simulated.plant.repeatability
    stopped = own.q + scatter * rng.standard_normal(own.q.shape)
    exact = plant.smr_positions(name, stopped, **conditions)
    moved = hidden.smr_positions(name, stopped, **conditions) - exact
    rms_m = _rms(moved)
    if rms_m < _STILL_M:
        return None
    scale = size_m / rms_m
    points, covariance = plant.measure_positions(exact + scale * moved, rng)
    further: dict[str, Any] = {}
    if (probe := cell.profile.arms[name].smr.probe) is not None:
        before = plant.probe_rotations(name, stopped, **conditions)
        turned = rotation_vectors(hidden.probe_rotations(name, stopped, **conditions) @ before.swapaxes(1, 2))
        error = Rotation.from_rotvec(scale * turned + probe.sigma * rng.standard_normal(moved.shape))
        quaternion = quaternions_of(error.as_matrix() @ before)
        further = {"quaternion_M": quaternion, "sigma_rad": np.full(len(moved), probe.sigma)}
    visible = _rms(beyond_geometry(cell.profile.arms[name], stopped, exact, moved)) / rms_m
    return replace(own, p_M=points, covariance_M=covariance, **further), visible


def _searched(cell: TrialCell, asked: NamingTrial, readings: Readings, visible: float) -> NamingTrial:
    """Return the trial with what calibration and search accept."""
    name = asked.arm
    profile = cell.profile.model_copy(update={"seed": asked.seed})
    splits, _ = profile_splits(profile, cell.readings)  # by the stops, independent of the measurements
    own = replace(readings, split=splits[name])
    model = calibrate_arm(profile, name, own)[0].model
    conditions = conditions_of_arms({**cell.models, name: model}, {**cell.readings, name: own})[name]
    accepted = discover_arm(profile, name, model, own, conditions=conditions).result.accepted
    named = next((one for one in accepted if one.effect == asked.effect), None)
    return asked.model_copy(
        update={
            "visible": visible,
            "accepted": tuple(one.effect for one in accepted),
            "named": None if named is None else _largest(named),
        }
    )


def _largest(effect: AcceptedEffect) -> SmallestSize:
    """Return the largest value among the parameters with the unit that the law names first."""
    values = list(effect.parameters.values())
    unit = values[0].unit if values else ""
    return SmallestSize(value=max((abs(one.value) for one in values if one.unit == unit), default=0.0), unit=unit)


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
