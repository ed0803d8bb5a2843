"""Recalibration of an arm with its earlier calibration as prior.

1. The earlier calibration becomes a belief about the arm's own parameters (``belief``). The likelihood of the new
   readings decides which parts of it are used.
2. Drifts of these parts and the scatter of the new readings maximise the likelihood of these (below).
3. Jumps of single parameters, effects or curves are added one after another while one is proven (``changes``).
4. Geometry, effects, base and tool follow from the new readings and the belief, widened by drifts and jumps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.quantities import ArmReadings, Quantities, with_probe
from cellapp.estimation.calibration.records import PartDrift, SignatureChange, SignaturePart
from cellapp.estimation.discovery.prior_fit import Posterior, design, posterior, term_columns
from cellapp.estimation.prior.belief import Belief, is_own, sizes
from cellapp.estimation.readings import covariances_of
from cellapp.ground.counting import plain
from cellapp.ground.errors import NotConverged
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectTerm
from cellapp.robot.kinematics.chain import all_names, parameter_names, parameter_unit
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import nominal_arm

# -- Validity of a belief about an arm for new readings, judged by their marginal likelihood --------------------------
#
# With X the derivatives of the readings by all parameters, y the residuals of the belief's mean, S the belief's
# covariance, D the variances of changes since, and R the readings' own covariance:
#
#     y ~ N(F b, K),    K = X (S + D) X^T + R,    b free (base and tool).
#
# The likelihood is that of the components of y in the complement of F (Patterson, Thompson, Biometrika 58 (1971) 545).
# Changes are of two kinds: a drift of all parameters of a part, with one size each, and jumps of a few parameters with
# separate causes. The drifts and the scatter of the readings maximise the likelihood; a jump is accepted if it gains
# more than chance explains.

_NO_DRIFT = 1e-7
"""Least drift: of geometry [m, rad]; of effects and curves relative to their size, below all real effects."""
_MOST_DRIFT: Mapping[SignaturePart, float] = {"geometry": 5e-3, "effects": 0.1, "curves": 3.0}
"""Largest drift in the same units. At it, nothing of geometry and curves is believed. A stiffness or a play that
changes by more than a tenth has a separate cause: a jump, which names it; a drift of so few values would hide it."""
_FIRST_DRIFT: Mapping[SignaturePart, float] = {"geometry": 1e-5, "effects": 0.02, "curves": 0.02}
"""Start values of the drifts: metals of an arm grow by some 10 um with a degree."""
_SCATTER_M = (1e-7, 1e-2)
"""Least and largest scatter of a coordinate beyond the stated one [m, rad]."""
_FIRST_SCATTER = (2e-5, 1e-4)
"""Start values of the scatter, of a coordinate [m] and of a component of an orientation [rad]."""
_EVALUATIONS = 1000
"""Most evaluations of the likelihood for two to four hyperparameters; it settles after some 80, rarely after 200."""
_DEPENDENT = 1e-9
"""Share of the largest pivot below which a column of base and tool counts as dependent on the others."""
_TOLERANCE = 0.01
"""Change of the log likelihood, and of the log of a drift, at which the search ends."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Parameters that may have jumped together, with a standard deviation each; ``what`` is the name of the group."""

    what: str
    places: NDArray[np.intp]
    sd: Array


@dataclass(frozen=True, eq=False)
class Drifts:
    """Drift of all parameters of each part, scatter of the readings, and the log likelihood there.

    ``scatters`` are that of a coordinate [m], and of a component of an orientation [rad] if one was measured.
    """

    of_parts: Mapping[SignaturePart, float]
    scatters: tuple[float, ...]
    log_likelihood: float


@dataclass(frozen=True, eq=False)
class UpdateFit:
    """Estimated change (r,) of a candidate's parameters, its covariance, and the gain of the log likelihood."""

    values: Array
    covariance: Array
    gain: float


@dataclass(frozen=True, eq=False)
class NewEvidence:
    """Linear model of new readings in the complement of base and tool.

    Attributes
    ----------
    residuals : array, shape (d,)
        Residuals of the readings for the mean of the belief.
    rows : array, shape (p, d)
        Derivatives by the arm's own parameters.
    believed : array, shape (d, d)
        ``X S X^T``.
    stated : array, shape (d, d)
        Stated covariance of the readings [m^2], zero if none is stated.
    drift : mapping
        Part -> ``X U X^T`` (d, d), with U the squared drift units of the parameters; empty if nothing is believed.
    of_rotations : array, shape (d, d), or None
        Covariance of a scatter of 1 rad in each component of the orientations alone.
    """

    residuals: Array
    rows: Array
    believed: Array
    stated: Array
    drift: Mapping[SignaturePart, Array]
    of_rotations: Array | None = None

    @classmethod
    def of(cls, belief: Belief, model: ArmModel, judged: Quantities) -> NewEvidence:
        """Linearise readings at the mean of a belief, with any base and tool."""
        joints = model.geometry.joints
        free = tuple(column for column in range(len(model.geometry.names)) if not is_own(column, joints))
        every = design(model, judged, (*free, *belief.columns))
        by_free = every[: len(free)] / np.maximum(np.linalg.norm(every[: len(free)], axis=1), 1e-300)[:, None]
        Q, R, _ = scipy.linalg.qr(by_free.T, pivoting=True)
        pivots = np.abs(np.diag(R))
        Z = Q[:, int(np.sum(pivots > _DEPENDENT * pivots[0])) :]
        drifting = () if belief.is_forgotten else dict.fromkeys(belief.parts)
        rows, units = every[len(free) :] @ Z, {part: _units(belief, part) for part in drifting}
        angular = None if judged.angular is None else np.tile(judged.angular, 3)
        return cls(
            residuals=Z.T @ judged.residuals(model).T.ravel(),
            rows=rows,
            believed=rows.T @ belief.covariance @ rows,
            stated=Z.T @ _covariance_matrix(judged.stated, len(judged)) @ Z,
            drift={part: (rows * unit[:, None] ** 2).T @ rows for part, unit in units.items()},
            of_rotations=None if angular is None else Z[angular].T @ Z[angular],
        )

    def jumped(self, candidate: Candidate) -> NewEvidence:
        """Return the model that allows for a jump of some parameters."""
        rows = self.rows[candidate.places] * candidate.sd[:, None]
        return replace(self, believed=self.believed + rows.T @ rows)

    def covariance(self, drifts: Mapping[SignaturePart, float], scatters: Sequence[float]) -> Array:
        """Return K (d, d) [m^2, m rad, rad^2]; ``scatters`` as in ``Drifts``."""
        K = self.believed + self.stated
        for part, size in drifts.items():
            K = K + size**2 * self.drift[part]
        K.flat[:: len(K) + 1] += scatters[0] ** 2
        if self.of_rotations is not None:
            K += (scatters[1] ** 2 - scatters[0] ** 2) * self.of_rotations
        return K

    def log_likelihood(self, drifts: Mapping[SignaturePart, float], scatters: Sequence[float]) -> float:
        """Return the log marginal likelihood, without the constants."""
        factor, lower = scipy.linalg.cho_factor(self.covariance(drifts, scatters), lower=True, check_finite=False)
        solved = scipy.linalg.cho_solve((factor, lower), self.residuals, check_finite=False)
        return float(-0.5 * self.residuals @ solved - np.sum(np.log(np.diag(factor))))

    def drifts(self, start: Drifts | None = None) -> Drifts:
        """Return the drifts and the scatter that maximise the likelihood, searched from ``start``; never a worse point.

        Raise ``NotConverged`` if the search does not end.
        """
        parts, kinds = list(self.drift), 1 if self.of_rotations is None else 2
        bounds = [
            *((math.log(_NO_DRIFT), math.log(_MOST_DRIFT[part])) for part in parts),
            *((math.log(_SCATTER_M[0]), math.log(_SCATTER_M[1])),) * kinds,
        ]

        def loss(x: Array) -> float:
            inside = np.clip(x, [low for low, _ in bounds], [high for _, high in bounds])
            sizes = np.exp(inside).tolist()
            return -self.log_likelihood(dict(zip(parts, sizes[:-kinds], strict=True)), sizes[-kinds:])

        first = [_FIRST_DRIFT[part] for part in parts] if start is None else [start.of_parts[part] for part in parts]
        x0 = np.log(np.array([*first, *(_FIRST_SCATTER[:kinds] if start is None else start.scatters)]))
        simplex = np.vstack([x0, x0 + 1.5 * np.eye(len(x0))])
        options = {"maxfev": _EVALUATIONS, "xatol": _TOLERANCE, "fatol": _TOLERANCE, "initial_simplex": simplex}
        found = scipy.optimize.minimize(loss, x0, method="Nelder-Mead", bounds=bounds, options=options)
        if not found.success:
            raise NotConverged.of("search of the drifts since an earlier calibration", found.message)
        sizes = np.exp(found.x).tolist()
        of_parts = dict(zip(parts, sizes[:-kinds], strict=True))
        return Drifts(of_parts, tuple(sizes[-kinds:]), -float(found.fun))

    def estimates(self, drifts: Drifts, candidates: list[Candidate]) -> list[UpdateFit]:
        """Return the estimated jump of each candidate, and its gain of the log likelihood."""
        K = self.covariance(drifts.of_parts, drifts.scatters)
        factor = scipy.linalg.cho_factor(K, lower=True, check_finite=False)
        solved = scipy.linalg.cho_solve(factor, self.rows.T, check_finite=False)
        moment = solved.T @ self.residuals
        found = []
        for one in candidates:
            S = self.rows[one.places] @ solved[:, one.places]
            scaled = S * one.sd * one.sd[:, None]
            b = moment[one.places] * one.sd
            inner = np.eye(len(b)) + scaled
            values = np.linalg.solve(inner, b)
            gain = 0.5 * float(b @ values) - 0.5 * float(np.linalg.slogdet(inner)[1])
            covariance = np.linalg.inv(inner) * one.sd * one.sd[:, None]
            found.append(UpdateFit(values * one.sd, covariance, gain))
        return found


# -- Possible changes of an arm since an earlier calibration: candidates, and proven ones in words --------------------

SURE = 5.0
"""Gain of the log likelihood that a change needs beyond the log of the number of candidates: twice of it is very strong
evidence (Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773)."""
ALIKE = 3.0
"""Difference of gains within which another change counts as equally good: a Bayes factor of 20."""
_GONE = 2.0
"""Standard errors within which the new value of an effect counts as zero."""
_SHOWN = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}
"""Displayed units and their factors."""
_WORDS = {"theta": "zero of joint", "d": "length d of link", "a": "length a of link", "alpha": "twist alpha of link"}
_BETA = "twist beta of link"


def candidates(belief: Belief, columns: Sequence[EffectColumn]) -> list[Candidate]:
    """Return the candidates: single geometric parameters, and the parameters of each effect at each place.

    ``columns`` are those of the belief's effects, in the order of their values.
    """
    names = change_names(belief.nominal.joints, belief.columns, belief.terms, columns)
    places = grouped((what, place) for place, what in enumerate(names))
    return [Candidate(what, np.array(some, dtype=np.intp), belief.jump_sd[some]) for what, some in places.items()]


def change_names(
    joints: int, columns: Sequence[int], terms: Sequence[EffectTerm], of_terms: Sequence[EffectColumn]
) -> list[str]:
    """Name a change of each parameter of an arm: geometric ``columns``, then values of effects with their columns."""
    names, slugs = all_names(joints), [term.slug for term in terms for _ in term.names]
    effects = [f"{EFFECTS[slug].title}, {column.where}" for slug, column in zip(slugs, of_terms, strict=True)]
    return [*(parameter_words(names[column]) for column in columns), *effects]


def change_of(
    belief: Belief, one: Candidate, found: UpdateFit, rows: Array, alternatives: Sequence[str], since: str, tested: int
) -> SignatureChange:
    """Describe a proven change; ``rows`` (r, d) [m] are the derivatives of the SMR coordinates by its parameters."""
    part = belief.parts[int(one.places[0])]
    moved = float(np.sqrt(3.0 * np.mean((found.values @ rows) ** 2))) * 1e3
    errors = np.sqrt(np.diag(found.covariance))
    gone = part == "effects" and bool(np.all(np.abs(belief.mean[one.places] + found.values) <= _GONE * errors))
    after = f"; as likely: {', '.join(alternatives)}" if alternatives else ""
    change = SignatureChange(
        what=one.what,
        part=part,
        evidence=2.0 * found.gain,
        moved_mm=moved,
        rivals=tuple(alternatives),
        sentence=f"{one.what} {'vanished' if gone else 'changed'} since {since}: {moved:.3f} mm rms at the SMR"
        f" (evidence {2.0 * found.gain:.0f}){after}",
    )
    if len(one.places) > 1:
        return change
    value, error = float(found.values[0]), float(errors[0])
    sigmas = abs(value) / error
    unit = _unit(belief, int(one.places[0]))
    factor, shown = _SHOWN.get(unit, (1.0, unit))
    return change.model_copy(
        update={
            "value": value,
            "standard_error": error,
            "unit": unit,
            "sigmas": sigmas,
            "p_value": min(1.0, tested * float(scipy.special.erfc(sigmas / math.sqrt(2.0)))),
            "sentence": f"{one.what}: {'vanished, ' if gone else ''}{'+' if value > 0.0 else ''}{plain(factor * value)}"
            f" {shown} +- {plain(factor * error, 2)} since {since} ({sigmas:.1f} sigma){after}",
        }
    )


def alike(all_candidates: Sequence[Candidate], found: Sequence[UpdateFit], best: int) -> list[str]:
    """Return the candidates that explain the readings about as well as the best one."""
    limit = found[best].gain - ALIKE
    return [
        one.what
        for number, (one, its) in enumerate(zip(all_candidates, found, strict=True))
        if number != best and its.gain > limit
    ]


def _unit(belief: Belief, place: int) -> str:
    if place < len(belief.columns):
        return parameter_unit(parameter_names(belief.nominal.joints)[belief.columns[place]])
    units = [unit for term in belief.terms for unit in term.units]
    return units[place - len(belief.columns)]


def parameter_words(name: str) -> str:
    """Return a parameter in words: ``theta3`` as ``zero of joint 3``."""
    letters = name.rstrip("0123456789")
    number = name.removeprefix(letters)
    return f"{_WORDS.get(letters, _BETA)} {number}"


_MOST_CHANGES = 10
"""Most jumps: all joints of an arm may have new gears."""
_MOST_READINGS = 300
"""Most measured vectors for drifts and jumps: the cost grows with the cube, and a few hundred show them."""
_FEW_READINGS = 100
"""Most vectors for deciding which parts are believed: a wrong part contradicts most of them."""
_SUBSET_SEED = 0x51A7
"""Combined with the profile's seed, so that the sample of these readings is independent of all other samples."""
_BELIEVED = 0.5
"""Share of the parameters' largest size above which the drift of a part means that it is not believed."""


@dataclass(frozen=True, eq=False)
class Updated:
    """Outcome: the belief as used, the posterior, and the reports on both."""

    belief: Belief
    found: Posterior
    parts: Mapping[SignaturePart, PartDrift]
    changes: tuple[SignatureChange, ...]
    tested: int
    scatter_m: float
    scatter_rad: float | None = None

    @property
    def used(self) -> bool:
        """Whether any part of the earlier calibration was believed."""
        return not self.belief.is_forgotten


def first_model(profile: Profile, name: str, measured: Quantities, belief: Belief) -> ArmModel:
    """Return the arm by its belief, with base, tool and probe fitted to the new readings."""
    arm, its = profile.arms[name], measured.positions
    readings, conditions = its.readings, its.conditions
    nominal = nominal_arm(arm)
    unknown = arm.smr.offset == "unknown"
    start = start_from_nominal(nominal, readings.q, readings.p_M, tool_unknown=unknown)
    believed = belief.geometry(nominal)
    model = ArmModel.of(profile, name, believed.with_T_M_B(start.T_M_B()), start)
    model = replace(model, effects=belief.terms)
    true_q = model.true_joints(readings.q, conditions=conditions)
    model = replace(model, geometry=start_from_nominal(believed, true_q, readings.p_M, tool_unknown=True))
    if measured.angular is None:
        return model
    true_q = model.true_joints(measured.readings.q, conditions=measured.conditions)
    geometry = with_probe(model.geometry, true_q, measured.conditions.R_M_S)
    return replace(model, geometry=geometry, nominal=replace(model.nominal, probe=geometry.probe))


def update(arm: ArmReadings, belief: Belief, since: str, further: Sequence[EffectTerm] = ()) -> Updated:
    """Calibrate an arm from readings and the ``belief``; ``further`` effects have only the priors of their laws.

    Raises
    ------
    numpy.linalg.LinAlgError
        If readings are not finite.
    """
    profile, measured = arm.profile, arm.quantities()
    supported = _supported(profile, arm.name, measured, belief)
    model = first_model(profile, arm.name, measured, supported)
    judged = measured.take(_subset(profile, len(measured), _MOST_READINGS))
    changed, drifts, changes, tested = _changed(supported, model, judged, since)
    first = len(sizes(profile, model, measured))
    model = replace(model, effects=(*model.effects, *further))
    found = posterior(model, measured, changed.prior(model.nominal, sizes(profile, model, measured)[first:]))
    parts = {part: _part(belief, part, drifts.of_parts.get(part)) for part in dict.fromkeys(belief.parts)}
    return Updated(changed, found, parts, tuple(changes), tested, *drifts.scatters)


def _supported(profile: Profile, name: str, measured: Quantities, belief: Belief) -> Belief:
    """Return the belief, or ``belief.forgotten()`` if that makes the readings likelier."""
    some = measured.take(_subset(profile, len(measured), _FEW_READINGS))
    found = []
    for one in (belief, belief.forgotten()):
        drifts = NewEvidence.of(one, first_model(profile, name, some, one), some).drifts()
        found.append((drifts.log_likelihood - len(drifts.of_parts), one))
    return max(found, key=lambda pair: pair[0])[1]


def _changed(
    belief: Belief, model: ArmModel, judged: Quantities, since: str
) -> tuple[Belief, Drifts, list[SignatureChange], int]:
    """Return the belief widened by drifts and proven jumps, both of these, and the number of jumps tested."""
    problem = NewEvidence.of(belief, model, judged)
    drifts = problem.drifts()
    remaining = [] if belief.is_forgotten else candidates(belief, term_columns(model, judged))
    tested, needed = len(remaining), SURE + math.log(max(len(remaining), 1))
    variance = np.zeros(len(belief.mean))
    changes: list[SignatureChange] = []
    while len(changes) < _MOST_CHANGES and remaining:
        estimates = problem.estimates(drifts, remaining)
        best = int(np.argmax([one.gain for one in estimates]))
        chosen = remaining[best]
        jumped = problem.jumped(chosen)
        after = jumped.drifts(drifts)
        if after.log_likelihood - drifts.log_likelihood < needed:
            break
        # drifts shrink once the jump is allowed for: judge it beside them
        again = problem.estimates(after, remaining)
        rows = problem.rows[chosen.places]
        changes.append(change_of(belief, chosen, again[best], rows, alike(remaining, again, best), since, tested))
        variance[chosen.places] += chosen.sd**2
        remaining = remaining[:best] + remaining[best + 1 :]
        problem, drifts = jumped, after
    for part, size in drifts.of_parts.items():
        variance += size**2 * _units(belief, part) ** 2
    return belief.widened(variance), drifts, changes, tested


def _covariance_matrix(stated: Array | None, count: int) -> Array:
    """Return the stated uncertainty as a matrix (3 n, 3 n) [m^2], coordinates first."""
    whole = np.zeros((3, count, 3, count))
    if stated is not None:
        rows = np.arange(count)
        whole[:, rows, :, rows] = covariances_of(stated)
    return whole.reshape(3 * count, 3 * count)


def _units(belief: Belief, part: SignaturePart) -> Array:
    """Return the unit of drift (p,) of each parameter of a part: 1 m or rad for geometry, its size for an effect."""
    units, places = np.zeros(len(belief.mean)), belief.places(part)
    units[places] = 1.0 if part == "geometry" else belief.jump_sd[places]
    return units


def _part(belief: Belief, part: SignaturePart, drift: float | None) -> PartDrift:
    places = belief.places(part)
    size = float(np.sqrt(np.mean(belief.jump_sd[places] ** 2))) if part == "geometry" else 1.0
    return PartDrift(
        parameters=len(places),
        drift=drift,
        unit="m, rad" if part == "geometry" else "of their size",
        used=drift is not None and drift < _BELIEVED * size,
    )


def _subset(profile: Profile, count: int, most: int) -> NDArray[np.intp]:
    if count <= most:
        return np.arange(count, dtype=np.intp)
    generator = np.random.default_rng([profile.seed, _SUBSET_SEED])
    return np.sort(generator.permutation(count)[:most]).astype(np.intp)
