"""Simulated cells that were calibrated, and readings of them some time later."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cellapp.estimation.calibration.parameters import candidate_columns
from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.discovery.prior_fit import Prior, posterior
from cellapp.estimation.monitoring.belief import CheckBelief, SequentialState, arm_belief, watching
from cellapp.estimation.monitoring.causes import Design
from cellapp.estimation.monitoring.linear import StopRows
from cellapp.estimation.monitoring.sequential import NOTHING_YET, choose_stops, design_of, judged
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.kinematics.transforms import rotation_from_vector, transform
from cellapp.robot.model import ArmModel
from tests.arms import OFF_AXIS, SEVEN, UR5, UR10, at_station, measured_rotations, true_geometry
from tests.series import readings_at

Array = NDArray[np.float64]
SIGMA_M = 1.5e-5
"""Noise of a coordinate: a laser tracker at 4 m."""
SIGMA_RAD = 4e-5
"""Noise of a component of the orientation of a 6-D probe."""
BESIDE = transform(rotation_from_vector([-0.02, 0.06, 2.4]), [2.9, -0.8, -0.6])


@dataclass(frozen=True, eq=False)
class SimulatedCell:
    """The true arms, and what a calibration from random readings says of them."""

    true: dict[str, Geometry]
    belief: CheckBelief
    candidates: dict[str, Array] = field(repr=False)

    @cached_property
    def design(self) -> Design:
        """What a check of it tests."""
        return design_of(self.belief)

    def chosen(self, count: int) -> NDArray[np.intp]:
        """The stops that a check of it chooses."""
        known = {name: arm.positions.readings for name, arm in self.belief.arms.items()}
        return choose_stops(self.design, known, count)

    def measured(self, stops: NDArray[np.intp] | list[int], seed: int, **changed: Geometry) -> dict[str, Readings]:
        """Readings at some candidates, in order, of a cell of which some arms have another true geometry now."""
        q = {name: some[np.asarray(stops)] for name, some in self.candidates.items()}
        return {
            name: readings_of(changed.get(name, true), q[name], np.random.default_rng([seed, place, 77]))
            for place, (name, true) in enumerate(self.true.items())
        }


def readings_of(true: Geometry, q: Array, rng: np.random.Generator) -> Readings:
    """What a tracker measures of an arm without effects; of a probe its orientation too."""
    n = len(q)
    model = model_of(true, true)
    angular: dict[str, Any] = {}
    if true.probe is not None:
        angular = {"quaternion_M": measured_rotations(model, q, SIGMA_RAD, rng), "sigma_rad": SIGMA_RAD}
    steps = np.diff(np.vstack([np.zeros(q.shape[1]), q]), axis=0)
    p_M, covariance_M = model.predict(q) + rng.normal(0.0, SIGMA_M, (n, 3)), np.tile(SIGMA_M**2 * np.eye(3), (n, 1, 1))
    return readings_at(q, p_M, approach=np.sign(steps), covariance_M=covariance_M, **angular)


def model_of(geometry: Geometry, nominal: Geometry) -> ArmModel:
    """An arm with links of 2 kg."""
    bodies = Bodies(np.full(geometry.joints, 2.0), np.full((geometry.joints, 3), 0.05), 0.3, np.zeros(3))
    return ArmModel(geometry, nominal, bodies, np.array([0.0, 0.0, 1.0]))


def cell_of(arms: dict[str, Geometry], seed: int, readings: int = 150) -> SimulatedCell:
    """A cell whose arms have these nominal geometries, and whose true ones are near; calibrated from readings."""
    true, beliefs, candidates = {}, {}, {}
    for place, (name, nominal) in enumerate(arms.items()):
        rng = np.random.default_rng([seed, place])
        true[name] = true_geometry(nominal, rng)
        candidates[name] = rng.uniform(-2.0, 2.0, (readings, nominal.joints))
        if nominal.probe is not None:
            true[name] = replace(true[name], probe=nominal.probe + rng.normal(0.0, 3e-3, 3))
        its = readings_of(true[name], candidates[name], rng)
        measured = measured_quantities(its, MeasurementConditions(approach=its.approach))
        columns = candidate_columns(nominal)
        model = watching(model_of(nominal, nominal), measured)
        count = len(columns) + sum(len(term.names) for term in model.effects)
        known = [0.0 if column < 6 or column >= 6 + 5 * nominal.joints else 1e6 for column in columns]
        precision = np.diag([*known, *[0.0] * (count - len(columns))])
        beliefs[name] = arm_belief(
            posterior(model, measured, Prior(columns, nominal, np.zeros(count), precision)), measured
        )
    return SimulatedCell(true, CheckBelief(beliefs), candidates)


def moved_base(true: Geometry, shift: list[float], rotation: list[float]) -> Geometry:
    """The arm on a base that moved in the tracker frame."""
    return true.with_T_M_B(transform(rotation_from_vector(rotation), shift) @ true.T_M_B())


def with_parameter(true: Geometry, place: int, change: float) -> Geometry:
    """The arm with one parameter changed."""
    vector = true.vector()
    vector[place] += change
    return true.with_vector(vector)


@pytest.fixture(scope="session")
def pair() -> SimulatedCell:
    return cell_of({"left": at_station(UR10, OFF_AXIS), "right": at_station(UR5, OFF_AXIS, BESIDE)}, 3)


def one_ur5() -> SimulatedCell:
    """A UR5 alone; its base is off the tracker's axis."""
    return cell_of({"only": at_station(UR5, OFF_AXIS)}, 4)


@pytest.fixture(scope="session")
def single() -> SimulatedCell:
    return one_ur5()


@pytest.fixture(scope="session")
def probed() -> SimulatedCell:
    """A UR10 with a 6-D probe."""
    return cell_of({"only": replace(at_station(UR10, OFF_AXIS), probe=np.array([0.1, -0.3, 0.4]))}, 6)


@pytest.fixture(scope="session")
def seven() -> SimulatedCell:
    return cell_of({"only": at_station(SEVEN, OFF_AXIS)}, 5)


def decided_prefix(design: Design, stops: StopRows) -> SequentialState:
    """The state of the test at the first stop at which it decides."""
    planned, state = len(stops.stop_ends), NOTHING_YET
    while not state.sure:
        state = judged(design, first_stops(stops, state.stops + 1), planned, state)
    return state


def first_stops(stops: StopRows, count: int) -> StopRows:
    """The first ``count`` stops."""
    d = int(stops.stop_ends[count - 1])
    return replace(
        stops,
        measured=stops.measured[: d // 3],
        expected=stops.expected[: d // 3],
        stop_ends=stops.stop_ends[:count],
        arm_of=stops.arm_of[: d // 3],
        rows=stops.rows[:, :d],
        factor=stops.factor[:d, :d],
        points=stops.points[: d // 3],
    )
