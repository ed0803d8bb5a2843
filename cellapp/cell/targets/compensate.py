"""Compensation: compute joint positions that bring the real arms to Cartesian targets, with the calibrated model.

Every target gets two commands: one from the published geometry, as an uncalibrated program would send it, and the
compensated one on the same branch, for the sides of approach stated with it. Of all inverse solutions that the gate
accepts, the nearest to home is chosen; solutions that the tracker sees take precedence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions, require_arms, visible_with_others
from cellapp.cell.safety.gate import CellBodies, refuse_stop
from cellapp.cell.targets.branches import (
    LARGEST_CORRECTION,
    Branches,
    Picked,
    Positions,
    admissible_configurations,
    choose,
    judged_branches,
)
from cellapp.cell.targets.goals import ArmGoals, goals_of_arm
from cellapp.cell.targets.prediction import (
    Command,
    Predicted,
    holds_for,
    outside_notes,
    predicted_relative,
    predicted_rotations,
    predictions,
    refused,
)
from cellapp.cell.targets.ranges import (
    ConditionRanges,
    conditions_payload,
    from_home,
    sided_commands,
    stated_conditions,
)
from cellapp.cell.targets.targets import Target
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.inverse import Inverted, all_branches, errors_and_jacobian, missed_distances, solve_pose
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.inverse import invert

_TOGETHER_ROUNDS = 2
"""Iterations for two arms that act on each other: in the second one their interaction changes by a thousandth."""


def compensate(
    profile: Profile,
    model: CellModel,
    targets: Sequence[Target],
    *,
    ranges: Mapping[str, ConditionRanges] | None = None,
) -> tuple[Command, ...]:
    """Return the commands of all targets in their order, one per arm of a cooperative target.

    Targets that an arm must not or cannot reach have a reason; a cooperative target is refused for both arms.
    ``ranges`` are what the readings of each arm covered; without them neither extrapolation nor unknown conditions
    whose plausible range the model does not contain (temperature, time, dwell) are reported.

    Raises
    ------
    InputError
        If the profile does not state where arms and tracker are, or the model is of other arms.
    """
    require_arms(profile, model)
    cell, homes = cell_bodies(profile, model), home_positions(profile)
    commands: dict[tuple[int, str], Command] = {}
    for names, numbers in grouped((target.arms, number) for number, target in enumerate(targets)).items():
        of_group = _Group.of(profile, model, cell, homes, names, [targets[number] for number in numbers], ranges or {})
        for name, of_arm in _commands(of_group).items():
            commands.update({(number, name): command for number, command in zip(numbers, of_arm, strict=True)})
    return tuple(commands[number, name] for number, target in enumerate(targets) for name in target.arms)


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Group:
    """The n targets of the same arms, with their cell; ``stated`` are their working conditions."""

    model: CellModel
    cell: CellBodies
    homes: Mapping[str, Array]
    targets: Sequence[Target]
    goals: Mapping[str, ArmGoals]
    stated: Mapping[str, MeasurementConditions]
    branches: Mapping[str, Branches]
    ranges: Mapping[str, ConditionRanges]

    @classmethod
    def of(
        cls,
        profile: Profile,
        model: CellModel,
        cell: CellBodies,
        homes: Mapping[str, Array],
        names: Sequence[str],
        targets: Sequence[Target],
        ranges: Mapping[str, ConditionRanges],
    ) -> _Group:
        """Compute and judge the nominal solutions of every arm."""
        goals = {name: goals_of_arm(model, targets, name) for name in names}
        stated = {
            name: replace(
                stated_conditions(profile, targets, name), record=ranges[name].record if name in ranges else None
            )
            for name in names
        }
        branches = {}
        for name, goal in goals.items():
            free = bool(np.isnan(goal.rotation_M).any())
            solutions = all_branches(
                model.arms[name].nominal,
                goal.nominal_position_M,
                goal.nominal_rotation_M,
                cell.arms[name].limits,
                homes[name],
                profile.seed,
                admissible_configurations(cell, homes, name, profile.seed) if free else None,
            )
            branches[name] = judged_branches(cell, homes, name, solutions)
        return cls(model, cell, homes, targets, goals, stated, branches, ranges)

    def solve(self, rows: NDArray[np.intp], nominal: Positions) -> dict[str, Inverted]:
        """Return solutions of the calibrated model for the targets ``rows``, near nominal ones (k, N) [rad]."""
        at, found = dict(nominal), {}
        goals = self.held(rows, nominal).goals
        for _ in range(_TOGETHER_ROUNDS if len(at) > 1 else 1):
            for name in nominal:
                goal, arm = goals[name], self.model.arms[name]
                conditions = self.conditions(name, rows, at)
                found[name] = invert(arm, goal.position_M[rows], goal.rotation_M[rows], at[name], conditions)
                at[name] = found[name].q
        return found

    def held(self, rows: NDArray[np.intp], nominal: Positions) -> _Group:
        """Return the group with the goals of targets ``rows`` whose first arm keeps its nominal command (k, N) [rad].

        Its goal is where the calibrated model puts it then; that of its partner follows, relative to it.
        """
        picked = np.array([k for k, row in enumerate(rows.tolist()) if self.targets[row].holds_first], dtype=np.intp)
        if not len(picked):
            return self
        (first, own), (second, other) = self.goals.items()
        at, q = rows[picked], nominal[first][picked]
        here = from_home(self.conditions(first, rows, nominal).take(picked), q, self.homes[first])
        rotation_M, _ = self.model.arms[first].flange(q, here)
        rotation = rotation_M @ own.rotation_M[at].swapaxes(1, 2)
        p_M = self.model.arms[first].predict(q, conditions=here)
        apart = np.einsum("nij,nj->ni", rotation, other.position_M[at] - own.position_M[at])

        def moved(goal: ArmGoals, position_M: Array, rotation_M: Array) -> ArmGoals:
            positions, rotations = goal.position_M.copy(), goal.rotation_M.copy()
            positions[at], rotations[at] = position_M, rotation_M
            return replace(goal, position_M=positions, rotation_M=rotations)

        goals = {first: moved(own, p_M, rotation_M), second: moved(other, p_M + apart, rotation @ other.rotation_M[at])}
        return replace(self, goals=goals)

    def conditions(self, name: str, rows: NDArray[np.intp], at: Positions) -> MeasurementConditions:
        """Return an arm's conditions at the targets ``rows``; the other arm of two is ``at`` (k, N) [rad] or home."""
        stated = self.stated[name].take(rows)
        others = [other for other in self.model.arms if other != name]
        if len(others) != 1:
            return stated
        (other,) = others
        q = at[other] if other in at else np.tile(self.homes[other], (len(rows), 1))
        payload = self.stated[other].payload_kg if other in self.stated else None
        return self.model.arms[other].beside(stated, q, None if payload is None else payload[rows])


def _commands(group: _Group) -> dict[str, list[Command]]:
    """Return the commands of every arm of a group, one for each target."""
    chosen = choose(group.cell, group.homes, group.branches, group.solve)
    reasons = _refusals(group, chosen)
    rows = np.flatnonzero(chosen.accepted)
    at = {name: found.q[rows] for name, found in chosen.compensated.items()}
    group = group.held(rows, {name: q[rows] for name, q in chosen.nominal.items()})
    each = {name: _of_arm(group, chosen, name, rows, at, reasons) for name in chosen.compensated}
    found = {name: commands for name, (commands, _) in each.items()}
    if len(found) == 2:
        targets = [group.targets[k] for k in rows.tolist()]
        free = [one.partner is None or one.partner.rpy is None for one in targets]
        limits = [None if any_will_do else one.orientation_tolerance_mrad for one, any_will_do in zip(targets, free)]
        tolerances = [one.tolerance_mm for one in targets], limits
        (_, first), (_, second) = each.values()
        relative = predicted_relative(first, second, *tolerances)
        for k, one in zip(rows.tolist(), relative, strict=True):
            found[group.targets[k].arms[1]][k] = found[group.targets[k].arms[1]][k].recording(relative=one)
    return found


def _of_arm(
    group: _Group, chosen: Picked, name: str, rows: NDArray[np.intp], at: Positions, reasons: Mapping[int, str]
) -> tuple[list[Command], Predicted]:
    """Return the commands of one arm, and what is predicted of the targets ``rows``, which are accepted.

    All arms are at positions ``at``.
    """
    goal, arm, home = group.goals[name], group.model.arms[name], group.homes[name]
    count = np.count_nonzero(group.branches[name].within, axis=1).tolist()
    commands = [refused(target, name, reasons.get(k, ""), count[k]) for k, target in enumerate(group.targets)]
    ranges, usual = group.ranges.get(name, ConditionRanges()), group.conditions(name, rows, at)
    best = chosen.compensated[name].take(rows)
    found, conditions, signs, others = sided_commands(
        arm, goal.position_M[rows], goal.rotation_M[rows], best, usual, home, ranges
    )
    q_nominal = chosen.nominal[name]
    tolerances = [group.targets[k].tolerance_mm for k in rows.tolist()]
    predicted = predictions(arm, found.q, conditions, tolerances, home, ranges, others)
    tolerances, wanted = [group.targets[k].orientation_tolerance_mrad for k in rows.tolist()], goal.nominal_rotation_M
    rotations = predicted_rotations(arm, found.q, q_nominal[rows], conditions, wanted[rows], tolerances, home, ranges)
    notes = outside_notes(found.q, conditions, ranges, predicted, arm.bodies.payload_mass)
    seen = visible_with_others(group.cell, group.homes, name, at)
    payloads = conditions_payload(conditions, arm.bodies.payload_mass, len(rows))
    for place, k in enumerate(rows.tolist()):
        rotated, tolerance_mm = float(found.residual_rad[place]), group.targets[k].tolerance_mm
        known: Mapping[str, Any] = {"verdict": "" if tolerance_mm is None else "not decided"}
        command = replace(
            commands[k],
            conditions=conditions.take(np.array([place])),
            expected_M=goal.position_M[k],
            nominal_M=goal.nominal_position_M[k],
            rotation_M=goal.rotation_M[k],
            nominal_rotation_M=goal.nominal_rotation_M[k],
        ).recording(
            **(known if (its := predicted[place]) is None else vars(its)),
            refusal="",
            q_nominal=tuple(q_nominal[k].tolist()),
            q_compensated=tuple(found.q[place].tolist()),
            visible=bool(seen[place]),
            residual_um=float(found.residual_m[place]) * 1e6,
            residual_urad=None if np.isnan(rotated) else rotated * 1e6,
            approach=tuple(map(int, signs[place])) if signs[place].any() else None,
            payload_kg=float(payloads[place]),
            note=notes[place],
            orientation=rotations[place],
        )
        commands[k] = command.recording(holds_for=holds_for(command))
    return commands, Predicted(arm, found.q, conditions, home, predicted, rotations)


def _refusals(group: _Group, chosen: Picked) -> dict[int, str]:
    """Return target index -> why it is not commanded."""
    missed: dict[str, dict[int, str]] = {}
    for name, one in group.branches.items():
        rows = np.flatnonzero(~one.exists.any(axis=1))
        goal = group.goals[name]
        words = missed_poses(
            group.model.arms[name].nominal,
            goal.nominal_position_M[rows],
            goal.nominal_rotation_M[rows],
            group.homes[name],
        )
        missed[name] = dict(zip(rows.tolist(), words, strict=True))
    return {
        row: refusal(group, chosen, row, {name: words.get(row, "") for name, words in missed.items()})
        for row in np.flatnonzero(~chosen.accepted).tolist()
    }


# -- Explain in words why a target is not commanded, one target at a time ---------------------------------------------


_ROUNDS = 25
"""Iterations towards the nearest pose of an unreachable one: enough for a millimetre."""
_TAKES_PART = 0.3
"""Share in the motion that leaves the SMR where it is (null space) above which a joint is named."""
_SAME_POSE = 1e-6
"""Residual [m, rad] below which a pose counts as reachable, although no start of the search reached it."""


def refusal(group: _Group, chosen: Picked, row: int, missed: Mapping[str, str]) -> str:
    """Return the reason of the best branch of a target; ``missed`` says how far arms without a solution are off."""
    for name, one in group.branches.items():
        of = f"arm {name}: " if len(group.branches) > 1 else ""
        if not one.exists[row].any():
            return of + missed[name]
        if not one.within[row].any():
            return of + _beyond_limits(one, row, group.cell.arms[name].limits)
    best = {name: q[row] for name, q in chosen.nominal.items()}
    if any(np.isnan(q).any() for q in best.values()):
        best = {name: _nearest(one, row) for name, one in group.branches.items()}
    if words := refuse_stop(group.cell, {**group.homes, **best}):
        return words
    for name, found in chosen.compensated.items():
        of = f"arm {name}: " if len(group.branches) > 1 else ""
        if words := _singular(group.model.arms[name], best[name], found.q[row], reached=bool(found.reached[row])):
            return of + words
    solved = {name: found.q[row] for name, found in chosen.compensated.items()}
    return refuse_stop(group.cell, {**group.homes, **solved}) or "the motion check does not admit it"


def missed_poses(geometry: Geometry, position_M: Array, rotation_M: Array, home: Array) -> list[str]:
    """Describe how far each of n unreachable poses is from the nearest reachable one."""
    if not len(position_M):
        return []
    free = np.isnan(rotation_M[:, 0, 0])
    wanted = np.where(free[:, None, None], np.eye(3), rotation_M)
    solved = solve_pose(geometry, position_M, wanted, np.tile(home, (len(wanted), 1)), max_iterations=_ROUNDS)
    words = []
    nearest = np.where(free, missed_distances(geometry, position_M, home), solved.residual_m)
    for off_m, off_rad, any_rotation in zip(nearest, solved.residual_rad, free, strict=True):
        if any_rotation:
            words.append(f"out of reach with any rotation: the SMR comes within {off_m * 1e3:.1f} mm")
        elif off_m < _SAME_POSE and off_rad < _SAME_POSE:
            words.append("no posture was found that reaches it")
        else:
            words.append(
                f"out of reach: the nearest pose is {off_m * 1e3:.1f} mm and {np.degrees(off_rad):.1f} deg off"
            )
    return words


# -- inside -----------------------------------------------------------------------------------------------------------


def _nearest(branches: Branches, row: int) -> Array:
    """Return the solution nearest to home among those within limits."""
    within = np.flatnonzero(branches.within[row])
    largest, total = branches.motion[:, row, within]
    return np.asarray(branches.q[row, within[np.lexsort((total, largest))[0]]])


def _beyond_limits(branches: Branches, row: int, limits: Array) -> str:
    """Describe the worst joint, and its excess, of the solution that exceeds its limits least."""
    beyond = np.where(branches.exists[row][:, None], branches.beyond[row], np.inf)
    best = int(np.argmin(beyond.max(axis=1)))
    joint = int(np.argmax(beyond[best]))
    low, high = np.degrees(limits[joint])
    return (
        f"beyond limits: joint {joint + 1} would stand {np.degrees(beyond[best, joint]):.3g} deg outside its limits"
        f" {low:.1f} to {high:.1f} deg"
    )


def _singular(arm: ArmModel, nominal: Array, solved: Array, *, reached: bool) -> str:
    """Report that the calibrated solution is lost in a singularity, and of which joints; empty if it is not."""
    moved = np.abs(solved - nominal)
    if reached and moved.max() <= LARGEST_CORRECTION:
        return ""
    _, J = errors_and_jacobian(arm.geometry, np.zeros((1, 3)), np.eye(3)[None], nominal[None])
    idle = np.abs(np.linalg.svd(J[0])[2][-1])
    joints = " and ".join(str(joint + 1) for joint in np.flatnonzero(idle > _TAKES_PART))
    where = f"singular: joints {joints} work against each other there"
    if not reached:
        return f"{where}, and the calibrated model does not reach it"
    worst = int(np.argmax(moved))
    return f"{where}, and joint {worst + 1} would rotate by {np.degrees(moved[worst]):.3g} deg"
