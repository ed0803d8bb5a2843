"""Recalibration of an arm with its earlier calibration as prior.

1. The earlier calibration becomes a belief about the arm's own parameters (``belief``). The likelihood of the new
   readings decides which parts of it are used.
2. Drifts of these parts and the scatter of the new readings maximise the likelihood of these (``evidence``).
3. Jumps of single parameters, effects or curves are added one after another while one is proven (``changes``).
4. Geometry, effects, base and tool follow from the new readings and the belief, widened by drifts and jumps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.quantities import with_probe
from cellapp.estimation.calibration.records import PartDrift, SignatureChange, SignaturePart
from cellapp.estimation.prior.belief import Belief, is_own, sizes
from cellapp.estimation.prior.changes import SURE, alike, candidates, change_of
from cellapp.estimation.prior.evidence import Drifts, Evidence, evidence
from cellapp.estimation.prior.linear_model import Measured, design, term_columns
from cellapp.estimation.prior.posterior import Posterior, posterior
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm, up_in_tracker

_MOST_CHANGES = 10
"""Most jumps: all joints of an arm may have new gears."""
_MOST_READINGS = 300
"""Most measured vectors for drifts and jumps: the cost grows with the cube, and a few hundred show them."""
_FEW_READINGS = 100
"""Most vectors for deciding which parts are believed: a wrong part contradicts most of them."""
_SUBSET_SEED = 0x51A7
"""Combined with the profile's seed, so that the draw of these readings is independent of all other draws."""
_PARTS: tuple[tuple[SignaturePart, ...], ...] = (
    ("geometry", "effects", "curves"),
    ("geometry", "curves"),
    ("geometry",),
)
"""Parts that may be believed together. Curves belong to their geometry; named effects may be wrong."""
_BELIEVED = 0.5
"""Share of the parameters' largest size above which the drift of a part means that it is not believed."""
_GEOMETRY_UNIT = "m, rad"
_SHARE_UNIT = "of their size"


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


def first_model(profile: Profile, name: str, measured: Measured, belief: Belief) -> ArmModel:
    """Return the arm by its belief, with base, tool and probe fitted to the new readings."""
    arm, its = profile.arms[name], measured.positions
    readings, conditions = its.readings, its.conditions
    nominal = nominal_arm(arm)
    unknown = arm.smr.offset == "unknown"
    model = ArmModel(
        geometry=nominal,
        nominal=start_from_nominal(nominal, readings.q, readings.p_M, tool_unknown=unknown),
        bodies=bodies_of(arm),
        up_M=up_in_tracker(profile),
        effects=belief.terms,
        smr_normal=np.array(arm.smr.normal, dtype=np.float64),
    )
    believed = belief.geometry(nominal)
    model = replace(model, geometry=believed.with_T_M_B(model.nominal.T_M_B()))
    true_q = model.true_joints(readings.q, conditions=conditions)
    model = replace(model, geometry=start_from_nominal(believed, true_q, readings.p_M, tool_unknown=True))
    if measured.turned is None:
        return model
    true_q = model.true_joints(measured.readings.q, conditions=measured.conditions)
    geometry = with_probe(model.geometry, true_q, measured.conditions.R_M_S)
    return replace(model, geometry=geometry, nominal=replace(model.nominal, probe=geometry.probe))


def update(
    profile: Profile,
    name: str,
    readings: Readings,
    conditions: MeasurementConditions,
    belief: Belief,
    since: str,
    further: Sequence[EffectTerm] = (),
) -> Updated:
    """Calibrate the arm from ``readings`` and the ``belief``; ``further`` effects have only the priors of their laws.

    Raises
    ------
    numpy.linalg.LinAlgError
        If readings are not finite.
    """
    measured = Measured.of(readings, conditions)
    supported = _supported(profile, name, measured, belief)
    model = first_model(profile, name, measured, supported)
    judged = measured.take(_subset(profile, len(measured), _MOST_READINGS))
    changed, drifts, changes, tested = _changed(supported, model, judged, since)
    first = len(sizes(profile, model, measured))
    model = replace(model, effects=(*model.effects, *further))
    found = posterior(model, measured, changed.prior(model.nominal, sizes(profile, model, measured)[first:]))
    parts = {part: _part(belief, part, drifts.of_parts.get(part)) for part in dict.fromkeys(belief.parts)}
    return Updated(changed, found, parts, tuple(changes), tested, drifts.scatter_m, drifts.scatter_rad)


def _supported(profile: Profile, name: str, measured: Measured, belief: Belief) -> Belief:
    """Return the belief about the parts that make the readings likeliest; without any, ``belief.forgotten()``."""
    some = measured.take(_subset(profile, len(measured), _FEW_READINGS))
    alternatives = {len(one.mean): one for parts in _PARTS for one in [belief.restricted(parts)]}
    found = []
    for one in (*alternatives.values(), belief.forgotten()):
        model = first_model(profile, name, some, one)
        problem = _evidence(one, model, some)
        if one.is_forgotten:
            problem = replace(problem, drift={})
        drifts = problem.drifts()
        found.append((drifts.log_likelihood - len(drifts.of_parts), one))
    return max(found, key=lambda pair: pair[0])[1]


def _changed(
    belief: Belief, model: ArmModel, judged: Measured, since: str
) -> tuple[Belief, Drifts, list[SignatureChange], int]:
    """Return the belief widened by drifts and proven jumps, both of these, and the number of jumps tested."""
    problem = _evidence(belief, model, judged)
    if belief.is_forgotten:
        problem = replace(problem, drift={})
        return belief, problem.drifts(), [], 0
    columns = term_columns(model, judged)
    left = candidates(belief, columns)
    tested, needed = len(left), SURE + math.log(max(len(left), 1))
    drifts = problem.drifts()
    variance = np.zeros(len(belief.mean))
    changes: list[SignatureChange] = []
    while len(changes) < _MOST_CHANGES and left:
        estimates = problem.estimates(drifts, left)
        best = int(np.argmax([one.gain for one in estimates]))
        chosen = left[best]
        jumped = problem.jumped(chosen)
        after = jumped.drifts(drifts)
        if after.log_likelihood - drifts.log_likelihood < needed:
            break
        # drifts shrink once the jump is allowed for: judge it beside them
        again = problem.estimates(after, left)
        rows = problem.rows[chosen.places]
        changes.append(change_of(belief, chosen, again[best], rows, alike(left, again, best), since, tested))
        variance[chosen.places] += chosen.sd**2
        left = left[:best] + left[best + 1 :]
        problem, drifts = jumped, after
    for part, size in drifts.of_parts.items():
        variance += size**2 * _units(belief, part) ** 2
    return belief.widened(variance), drifts, changes, tested


def _evidence(belief: Belief, model: ArmModel, judged: Measured) -> Evidence:
    joints = model.geometry.joints
    free = tuple(column for column in range(len(model.geometry.names)) if not is_own(column, joints))
    rows = design(model, judged, (*free, *belief.columns))
    return evidence(
        free=rows[: len(free)],
        own=rows[len(free) :],
        left=judged.left(model).T.ravel(),
        covariance=belief.covariance,
        stated=_covariance_matrix(judged.stated, len(judged)),
        units={part: _units(belief, part) for part in dict.fromkeys(belief.parts)},
        turned=None if judged.turned is None else np.tile(judged.turned, 3),
    )


def _covariance_matrix(stated: Array | None, count: int) -> Array:
    """Return the stated uncertainty as a matrix (3 n, 3 n) [m^2], coordinates first."""
    whole = np.zeros((3, count, 3, count))
    if stated is not None:
        blocks = stated[:, None, None] ** 2 * np.eye(3) if stated.ndim == 1 else stated
        rows = np.arange(count)
        for a in range(3):
            for b in range(3):
                whole[a, rows, b, rows] = blocks[:, a, b]
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
        unit=_GEOMETRY_UNIT if part == "geometry" else _SHARE_UNIT,
        used=drift is not None and drift < _BELIEVED * size,
    )


def _subset(profile: Profile, count: int, most: int) -> NDArray[np.intp]:
    if count <= most:
        return np.arange(count, dtype=np.intp)
    generator = np.random.default_rng([profile.seed, _SUBSET_SEED])
    return np.sort(generator.permutation(count)[:most]).astype(np.intp)
