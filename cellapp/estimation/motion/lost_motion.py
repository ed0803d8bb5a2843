"""Lost motion that a joint takes up over a reach: its reach and its kind of memory, from the residuals of a fit.

Beside play or wind-up, which change at once where a joint turns round, a part fades with the travel since
(``joint_path.Fading``). All reaches of all kinds are columns of one normal matrix; what each would take from the
residuals, beside all that the fit has, is a small system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellapp.estimation.calibration.linear import solve_psd
from cellapp.estimation.motion.fit import Problem, Solution, Source, normal_equations
from cellapp.estimation.motion.joint_path import Fading
from cellapp.estimation.motion.terms import JointTerm, Law, of_all_joints
from cellapp.robot.kinematics.transforms import Array

REACHES = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Reaches that are tried [rad]: 1.4 to 46 degrees."""
_KINDS = (Fading(1.0, kept=False), Fading(1.0, kept=True), Fading(1.0, kept=False, bell=True))
ALTERNATIVES = len(_KINDS) * len(REACHES)
"""Fading parts that chance may choose from."""
_MOST_POINTS = 8000
_OWN_REACH = 9.0
"""Chi-square that a reach of its own must gain of a joint: three standard deviations."""


def fading_terms(problem: Problem, solution: Solution, law: Law) -> tuple[JointTerm, ...]:
    """The fading part of ``law`` at all joints that takes most from the residuals: of one kind of memory, with one
    reach, but for joints that a reach of their own fits surely better."""
    gains = _gains(problem, solution, law)
    joints = range(problem.layout.parameters.joints)
    kind, place = max(
        ((kind, place) for kind in range(len(_KINDS)) for place in range(len(REACHES))),
        key=lambda one: gains.chi_square(one[0], [one[1]] * len(joints)),
    )
    places = [place] * len(joints)
    for joint in joints:
        tried = [[*places[:joint], own, *places[joint + 1 :]] for own in range(len(REACHES))]
        best = max(tried, key=lambda one: gains.chi_square(kind, one))
        if gains.chi_square(kind, best) > gains.chi_square(kind, places) + _OWN_REACH:
            places = best
    usual = gains.between(kind, place)
    return tuple(
        JointTerm(law, joint, fading=replace(_KINDS[kind], reach=usual if own == place else REACHES[own]))
        for joint, own in zip(joints, places)
    )


@dataclass(frozen=True, eq=False)
class _Gains:
    """Normal equations of all fading parts (kinds, reaches, joints) beside the parameters of a fit: ``matrix`` (K, K)
    and ``product`` (K,)."""

    matrix: Array = field(repr=False)
    product: Array = field(repr=False)
    joints: int

    def chi_square(self, kind: int, places: Sequence[int]) -> float:
        """What parts of these reaches, one of each joint, take from the residuals."""
        chosen = [(kind * len(REACHES) + place) * self.joints + joint for joint, place in enumerate(places)]
        product = self.product[chosen]
        return float(product @ solve_psd(self.matrix[np.ix_(chosen, chosen)], product))

    def between(self, kind: int, place: int) -> float:
        """The reach [rad] at the top of the parabola through a place on the grid and its neighbours."""
        if not 0 < place < len(REACHES) - 1:
            return REACHES[place]
        less, best, more = (self.chi_square(kind, [place + side] * self.joints) for side in (-1, 0, 1))
        bend = less - 2.0 * best + more
        top = 0.5 * (less - more) / bend if bend < 0.0 else 0.0
        return float(REACHES[place] * (REACHES[place + 1] / REACHES[place]) ** top)


def _gains(problem: Problem, solution: Solution, law: Law) -> _Gains:
    joints = problem.layout.parameters.joints
    tried = [
        JointTerm(law, joint, fading=replace(kind, reach=reach))
        for kind in _KINDS
        for reach in REACHES
        for joint in range(joints)
    ]
    plain = [term for term in of_all_joints(law, joints) if term not in problem.layout.terms]
    at, first = problem.layout.arm, problem.layout.arm + len(plain)
    # some of the points say which part fits best; the fit with it, and its evidence, are of all
    extended = replace(problem.with_terms((*plain, *tried)), whitening=None)
    sources = [_thinned(source, _MOST_POINTS // len(solution.sources)) for source in solution.sources]
    values = np.insert(solution.values, at, np.zeros(len(plain) + len(tried)))
    A, b = normal_equations(extended, values, sources)
    A, b = A + np.diag(extended.precision), b + extended.precision * (extended.mean - values)
    new = np.zeros(len(b), dtype=np.bool_)
    new[first : first + len(tried)] = True
    of_fit = solve_psd(A[~new][:, ~new], np.column_stack([A[~new][:, new], b[~new]]))
    matrix = A[new][:, new] - A[new][:, ~new] @ of_fit[:, :-1]
    product = b[new] - A[new][:, ~new] @ of_fit[:, -1]
    return _Gains(0.5 * (matrix + matrix.T), product, joints)


def _thinned(source: Source, most: int) -> Source:
    """Some of the rows of a source, each of more weight."""
    each = max(len(source.rows) // max(most, 1), 1)
    relative = None if source.relative is None else source.relative[::each]
    return replace(source, rows=source.rows[::each], worth=source.worth * each, relative=relative)
