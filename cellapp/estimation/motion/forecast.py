"""Forecast of stops and sweeps before any motion: errors of positions, smallest detectable sizes of effects.

Points of a motion are correlated: one of each half second counts as an independent reading, with the noise of the
tracker and the scatter of the arm, as in recordings of the twin (handbook, chapter "motion"). Information of stops and
sweeps adds up. A joint law is detectable from a size of ``SHOWN`` standard errors of its parameter, with the geometry,
the law of the other joints and, in motion, the delay between the clocks unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cellapp.estimation.calibration.least_squares import covariance_with_priors
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.discovery.arm_data import whitening
from cellapp.estimation.discovery.plan_forecast import accuracy_of
from cellapp.estimation.discovery.records import PlannedAccuracy
from cellapp.estimation.motion.steps import DENSE, SHOWN
from cellapp.estimation.motion.terms import JointState, JointTerm, Law
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian
from cellapp.robot.kinematics.transforms import Array

_CYCLES = (2, 40)
"""Cycles of the forecast lines: slow ones of eccentric parts, dense ones of gears."""
_PLAIN = (Law.PLAY, Law.WINDUP, Law.LAG, Law.COMPLIANCE)
"""Forecast laws with one parameter a joint."""
_DELAY_SD_S = 1.0
"""Prior standard deviation of the delay between the clocks: it is unknown."""


@dataclass(frozen=True, eq=False)
class Expected:
    """States (n) of an arm to be measured, and the covariance (n, 3, 3) of each point [m^2]."""

    state: JointState
    covariance: Array


@dataclass(frozen=True)
class LawForecast:
    """Forecast of a law: its effect, its cycles a turn for a line, the unit of its parameters, and the smallest
    detectable size in each joint, by source; None if no plausible size is detectable."""

    effect: str
    cycles: int
    unit: str
    smallest: Mapping[str, Mapping[str, float | None]] = field(repr=False)


def forecast_motion(
    nominal: Geometry,
    estimated: ParameterSet,
    priors: Array,
    sources: Mapping[str, Expected],
    at: Array,
    scatter_m: float,
) -> tuple[dict[str, PlannedAccuracy], tuple[LawForecast, ...]]:
    """Forecast position errors at ``at`` (n, N) [rad] and the smallest detectable sizes of the laws, by source and for
    all ``sources`` together ("both"); ``priors`` are prior standard deviations of the ``estimated`` geometric
    parameters."""
    laws = foreseen_laws(nominal.joints)
    terms = tuple(term for its in laws for term in its)
    told = {name: motion_information(nominal, estimated, terms, one) for name, one in sources.items()}
    told["both"] = np.sum(list(told.values()), axis=0)
    _, J = jacobian(nominal, JointAngles.of(at), estimated.columns)
    k = len(estimated.columns)
    accuracy = {name: accuracy_of(nominal, estimated, priors, its[:k, :k], J, scatter_m) for name, its in told.items()}
    sizes = {name: _smallest(its, priors, laws) for name, its in told.items()}
    forecasts = tuple(
        LawForecast(
            its[0].law.value,
            its[0].cycles,
            its[0].unit,
            {name: dict(zip(_names(its), own[number], strict=True)) for name, own in sizes.items()},
        )
        for number, its in enumerate(laws)
    )
    return accuracy, tuple(_aliased(one) if one.cycles >= DENSE else one for one in forecasts)


def foreseen_laws(joints: int) -> list[tuple[JointTerm, ...]]:
    """Return the terms of all joints, law by law, of the forecast laws."""
    plain = [tuple(JointTerm(law, joint) for joint in range(joints)) for law in _PLAIN]
    lines = [
        tuple(JointTerm(Law.LINE, joint, cycles, sine) for joint in range(joints) for sine in (False, True))
        for cycles in _CYCLES
    ]
    return [*plain, *lines]


def _names(terms: tuple[JointTerm, ...]) -> list[str]:
    """Return one name for each joint."""
    return [f"joint {term.joint + 1}" for term in terms if not term.sine]


def motion_information(
    nominal: Geometry, estimated: ParameterSet, terms: tuple[JointTerm, ...], expected: Expected
) -> Array:
    """Compute the information (P, P) on the geometry, the terms, and last the delay between the clocks."""
    state, k = expected.state, len(estimated.columns)
    thetas = tuple(6 + 5 * joint for joint in range(nominal.joints))
    _, J = jacobian(nominal, JointAngles.of(state.q), (*estimated.columns, *thetas))
    by_joint = J[:, k:]
    of_terms = [by_joint[:, term.joint] * term.offset(state) for term in terms]
    delay = -np.einsum("ajn,nj->an", by_joint, state.qd)
    columns = np.concatenate([J[:, :k], np.stack([*of_terms, delay], axis=1)], axis=1)
    X = np.einsum("acn,ckn->kan", whitening(expected.covariance), columns)
    flat = X.reshape(len(X), -1)
    return np.asarray(flat @ flat.T)


def _smallest(information: Array, priors: Array, laws: list[tuple[JointTerm, ...]]) -> list[list[float | None]]:
    """Return the smallest detectable size of each law in each joint."""
    first, found = len(priors), []
    for terms in laws:
        places = np.array([*range(len(priors)), *range(first, first + len(terms)), len(information) - 1])
        sds = np.concatenate([priors, [10.0 * term.prior_sd for term in terms], [_DELAY_SD_S]])
        own = slice(len(priors), -1)
        covariance = covariance_with_priors(information[np.ix_(places, places)], sds)[own, own]
        if terms[0].law is Law.LAG:
            less_mean = np.eye(len(terms)) - 1.0 / len(terms)
            covariance = less_mean @ covariance @ less_mean.T
        variance = np.diag(covariance)
        if terms[0].law is Law.LINE:
            variance = np.maximum(variance[::2], variance[1::2])
        sizes = SHOWN * np.sqrt(variance)
        found.append([size if size < 10.0 * terms[0].prior_sd else None for size in sizes.tolist()])
        first += len(terms)
    return found


def _aliased(one: LawForecast) -> LawForecast:
    """Mark lines as undetectable by stops, where they are aliased."""
    smallest = {name: dict.fromkeys(its) if name == "stops" else its for name, its in one.smallest.items()}
    return replace(one, smallest=smallest)
