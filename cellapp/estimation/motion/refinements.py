"""Refining parts of a law of all joints, with a non-linear constant chosen from the residuals of a fit.

Play and wind-up change at once where a joint reverses; a part fades with the travel since, over a reach
(``joint_path.Fading``). Springs push back in proportion; a part is softer below a knee torque. All constants of all
kinds are columns of one normal matrix. What each would remove from the residuals beside the present fit is the solution
of a small system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from cellapp.estimation.calibration.linear import solve_psd
from cellapp.estimation.motion.fit import Problem, Solution, Source, normal_equations
from cellapp.estimation.motion.joint_path import Fading
from cellapp.estimation.motion.terms import JointTerm, Knee, Law, of_all_joints, state_in_motion
from cellapp.robot.effects.joint_compliance import SOFTER
from cellapp.robot.kinematics.transforms import Array

REACHES = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Reaches to try [rad]: 1.4 to 46 degrees."""
_KINDS = (Fading(1.0, kept=False), Fading(1.0, kept=True), Fading(1.0, kept=False, bell=True))
_KNEES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Knees to try, as shares of the largest torque of the joint in all recordings."""
_NEARER = (0.025, 0.005)
"""Steps of the shares in the following finer searches, about those chosen."""
_STEPS = (-4, -3, -2, -1, 0, 1, 2, 3, 4)
_MOST_POINTS = 8000
_OF_ITS_OWN = 9.0
"""Chi-square that a separate constant, or a second knee, must gain at a joint: three standard deviations."""
_TORQUES = 1000
"""Points of each recording at which torques are computed."""
REFINED = (Law.PLAY, Law.WINDUP, Law.COMPLIANCE)
"""Laws with refining parts."""


def alternatives(law: Law) -> int:
    """Return the number of alternative parts, for the correction of p-values."""
    return len(_KNEES) ** 2 if law is Law.COMPLIANCE else len(_KINDS) * len(REACHES)


def refining_terms(problem: Problem, solution: Solution, law: Law) -> tuple[JointTerm, ...]:
    """Return the parts of one of the laws ``REFINED`` that remove most from the residuals: for lost motion of one kind
    and with one reach, except at joints that a separate reach fits clearly better; for compliance one or two knees a
    joint."""
    return _knees(problem, solution) if law is Law.COMPLIANCE else _fading(problem, solution, law)


def _fading(problem: Problem, solution: Solution, law: Law) -> tuple[JointTerm, ...]:
    joints, reaches = range(problem.layout.parameters.joints), range(len(REACHES))
    fading = [replace(kind, reach=reach) for kind in _KINDS for reach in REACHES]
    parts = [JointTerm(law, joint, fading=one) for one in fading for joint in joints]
    gains = _gains(problem, solution, law, parts)

    def gain(kind: int, places: Sequence[int]) -> float:
        return gains.chi_square([(kind * len(REACHES) + place) * len(joints) + j for j, place in enumerate(places)])

    kind, place = max(product(range(len(_KINDS)), reaches), key=lambda one: gain(one[0], [one[1]] * len(joints)))
    places = [place] * len(joints)
    for joint in joints:
        tried = [[*places[:joint], own, *places[joint + 1 :]] for own in reaches]
        best = max(tried, key=lambda one: gain(kind, one))
        if gain(kind, best) > gain(kind, places) + _OF_ITS_OWN:
            places = best
    usual = _top(REACHES, place, [gain(kind, [own] * len(joints)) for own in reaches])
    return tuple(
        JointTerm(law, joint, fading=replace(_KINDS[kind], reach=usual if own == place else REACHES[own]))
        for joint, own in zip(joints, places)
    )


def _top(grid: Sequence[float], place: int, gains: Sequence[float]) -> float:
    """Return the constant at the top of the parabola through a point of a geometric grid and its neighbours."""
    if not 0 < place < len(grid) - 1:
        return grid[place]
    less, best, more = gains[place - 1 : place + 2]
    bend = less - 2.0 * best + more
    top = 0.5 * (less - more) / bend if bend < 0.0 else 0.0
    return float(grid[place] * (grid[place + 1] / grid[place]) ** top)


def _knees(problem: Problem, solution: Solution) -> tuple[JointTerm, ...]:
    """Choose the knees of all joints: one of each, two where both clearly gain; then refine their values."""
    largest = _largest_torques(problem)
    options = [_one_or_two(_KNEES, _KNEES)] * len(largest)
    chosen = _best_shares(problem, solution, largest, options)
    for step in _NEARER:
        near = [[[share + step * n for n in _STEPS if share + step * n > 0.0] for share in own] for own in chosen]
        options = [_one_or_two(grids[0], grids[-1]) for grids in near]
        chosen = _best_shares(problem, solution, largest, options)
    return tuple(
        JointTerm(Law.COMPLIANCE, joint, knee=Knee(share * torque, constant))
        for joint, (own, torque) in enumerate(zip(chosen, largest.tolist()))
        for constant, share in zip(SOFTER, own)
    )


def _one_or_two(first: Sequence[float], second: Sequence[float]) -> list[tuple[float, ...]]:
    """Return each share alone, and each of the first with each larger one of the second."""
    alone = sorted({*first, *second})
    return [(one,) for one in alone] + [(one, other) for one in first for other in second if one < other]


def _best_shares(
    problem: Problem, solution: Solution, largest: Array, options: Sequence[Sequence[tuple[float, ...]]]
) -> list[tuple[float, ...]]:
    """Choose one option of each joint, joint by joint the one with the largest gain beside those of the others."""
    keys = [(joint, share) for joint, own in enumerate(options) for share in sorted({s for one in own for s in one})]
    parts = [JointTerm(Law.COMPLIANCE, joint, knee=Knee(share * largest[joint])) for joint, share in keys]
    gains, place = _gains(problem, solution, Law.COMPLIANCE, parts), {key: number for number, key in enumerate(keys)}

    def gain(chosen: Sequence[tuple[float, ...]]) -> float:
        columns = [place[joint, share] for joint, own in enumerate(chosen) for share in own]
        return gains.chi_square(columns) - _OF_ITS_OWN * len(columns)

    chosen = [own[len(own) // 2] for own in options]
    for joint in (*range(len(options)), *range(len(options))):
        chosen[joint] = max(options[joint], key=lambda one: gain([*chosen[:joint], one, *chosen[joint + 1 :]]))
    return chosen


def _largest_torques(problem: Problem) -> Array:
    """Return the largest torque (N,) [Nm] of each joint in all recordings."""
    largest = np.zeros(problem.layout.parameters.joints)
    for track in problem.tracks:
        stamps = track.path.stamps.time_s
        times = np.linspace(stamps[0], stamps[-1], _TORQUES)
        torque = state_in_motion(track.path, times, problem.masses, torques=True).torque
        largest = np.maximum(largest, np.abs(torque).max(axis=0))
    return largest


@dataclass(frozen=True, eq=False)
class _Gains:
    """Normal equations of parts beside the parameters of a fit: ``matrix`` (K, K) and ``right`` (K,)."""

    matrix: Array = field(repr=False)
    right: Array = field(repr=False)

    def chi_square(self, chosen: Sequence[int]) -> float:
        """Return the chi-square that some of the parts remove from the residuals."""
        right = self.right[chosen]
        return float(right @ solve_psd(self.matrix[np.ix_(chosen, chosen)], right))


def _gains(problem: Problem, solution: Solution, law: Law, parts: Sequence[JointTerm]) -> _Gains:
    every = of_all_joints(law, problem.layout.parameters.joints)
    plain = [term for term in every if term not in problem.layout.terms]
    at, first = problem.layout.arm, problem.layout.arm + len(plain)
    # a subset of the points selects the part; the fit with it, and its evidence, use all points
    extended = replace(problem.with_terms((*plain, *parts)), whitening=None)
    sources = [_thinned(source, _MOST_POINTS // len(solution.sources)) for source in solution.sources]
    values = np.insert(solution.values, at, np.zeros(len(plain) + len(parts)))
    A, b = normal_equations(extended, values, sources)
    A, b = A + np.diag(extended.precision), b + extended.precision * (extended.mean - values)
    new = np.zeros(len(b), dtype=np.bool_)
    new[first : first + len(parts)] = True
    of_fit = solve_psd(A[~new][:, ~new], np.column_stack([A[~new][:, new], b[~new]]))
    matrix = A[new][:, new] - A[new][:, ~new] @ of_fit[:, :-1]
    right = b[new] - A[new][:, ~new] @ of_fit[:, -1]
    return _Gains(0.5 * (matrix + matrix.T), right)


def _thinned(source: Source, most: int) -> Source:
    """Return a subset of the rows of a source, each with more weight."""
    each = max(len(source.rows) // max(most, 1), 1)
    relative = None if source.relative is None else source.relative[::each]
    return replace(source, rows=source.rows[::each], worth=source.worth * each, relative=relative)
