"""Visit one target: drive its arm or arms there with each command, measure at rest, and correct the remaining error.

Drive one or more arms to commands: straight, one after the other, or via home, never into a dead end.

Push compensated targets to the arms; with verification, measure the SMRs there and correct remaining errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.cell_checks import require_same_arms
from cellapp.cell.driving.motion import Confirm, MotionRefused, Mover, Targets, Vector, Way
from cellapp.cell.driving.supervision import moving_cell
from cellapp.cell.driving.verification import (
    Agreement,
    CommandKind,
    Findings,
    Measured,
    Rest,
    distance_error_m,
    mean_of,
    measured_rotation,
    predict_at_rest,
    result_of,
    rms_error_m,
)
from cellapp.cell.planning.planned_stops import orders, tell_time, visits_s
from cellapp.cell.targets.prediction import Command
from cellapp.cell.targets.ranges import conditions_of
from cellapp.cell.targets.records import VerifyResult
from cellapp.estimation.calibration.least_squares import NORMAL_95
from cellapp.estimation.uncertainty.budget import Judge
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, InputVariable
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.inverse import STEP_BACK_RAD, invert, with_approach
from drivers.arms.protocol import ArmState
from drivers.trackers.protocol import TargetLost, TrackerError, WrongTarget

Sides = Mapping[str, Vector]
"""Arm -> requested signs (N,) of each joint's last motion, 0 if it does not matter; arms left out have no request."""
CommandFrom = Callable[[str, Vector], Vector]
"""Function: arm and its joint positions (N,) [rad] before, which affect backlash -> its command (N,) [rad]."""

_STEPS_BACK_RAD = (STEP_BACK_RAD, np.radians(0.25))
"""The second one is for arms that are close to something."""


def drive_to(
    mover: Mover,
    targets: Targets,
    sides: Sides,
    step_rad: float = _STEPS_BACK_RAD[0],
    command: CommandFrom | None = None,
) -> dict[str, ArmState]:
    """Drive arms to ``targets`` from the given sides, the others home first. Return their states at rest.

    The last motion of each joint is ``step_rad`` times its side [rad]. Only motions after which the arms can move home
    again are allowed. ``command`` returns what is sent to an arm instead of its target.

    Raises
    ------
    MotionRefused
        If the gate accepts no way to the targets.
    CellStopped
        As ``Mover.move``.
    """
    here = mover.positions()
    away = [name for name in here if name not in targets and not mover.rests_at({name: mover.homes[name]})]
    if away:
        mover.go_home(away)

    def drive(start: Targets) -> dict[str, ArmState]:
        sent = targets if command is None else {name: command(name, start[name]) for name in targets}
        return _drive(mover, sent, sides, step_rad)

    try:
        return drive(here)
    except MotionRefused:
        mover.go_home(list(targets))
        return drive(mover.homes)


def _drive(mover: Mover, targets: Targets, sides: Sides, *steps_rad: float) -> dict[str, ArmState]:
    """Drive arms the first way that the gate accepts together with a way home, with the first step back if it can."""
    ways = [way for step_rad in steps_rad for way in _ways(targets, sides, step_rad)]
    return mover.along(ways, [*orders({name: mover.homes[name] for name in targets})])


def before_side(q: Vector, sides: Vector | None, step_rad: float = _STEPS_BACK_RAD[0]) -> Vector:
    """Return the position (N,) [rad] before ``q`` (N,) from which each joint with a sign arrives on that side."""
    return q if sides is None else np.asarray(q - step_rad * sides)


def arrival(q: Vector, start: Vector, sides: Vector | None) -> Vector:
    """Return the position (N,) [rad] from which each joint arrives at ``q`` (N,), starting at ``start`` (N,)."""
    return start if sides is None else np.where(sides != 0, before_side(q, sides), start)


def _ways(targets: Targets, sides: Sides, step_rad: float) -> Iterator[Way]:
    """Yield all arms at once, then one after the other in every order; with a step back if a side is requested."""
    legs = [targets]
    if any(np.any(sides[name]) for name in targets if name in sides):
        legs.insert(0, {name: before_side(q, sides.get(name), step_rad) for name, q in targets.items()})
    yield legs
    for order in permutations(targets) if len(targets) > 1 else ():
        yield [{name: leg[name]} for name in order for leg in legs]


States = dict[str, ArmState]

_UNSEEN = "not measured: the tracker does not see the SMR there"


@dataclass(frozen=True)
class TargetVisit:
    """Visits targets with the arms of an open cell; the parameters are those of ``push``."""

    model: CellModel
    mover: Mover
    verify: bool
    rounds: int
    repeatability_m: Mapping[str, float]

    def to(self, commands: Sequence[Command]) -> Findings:
        """Visit one target with the command of each of its arms.

        A refused motion, measurement or correction becomes a note; what stops the cell raises an exception.
        """
        held = commands[0].target.holds_first
        found = Findings({command.record.arm: command for command in commands}, corrected=self.rounds > 0 and not held)
        if self.rounds and held:
            found.note([commands[0].record.arm], "not corrected by measuring: the first arm keeps its command")
        for name, command in found.commands.items():
            others = [one.record for one in commands if one is not command]
            partners = [f"arm {one.arm}: {one.refusal}" for one in others if one.refusal]
            if command.record.refusal:
                found.note([name], command.record.refusal)
            elif partners:
                found.note([name], "; ".join(partners))
            elif self.verify and command.record.visible is False:
                found.note([name], _UNSEEN)
        unseen = self.verify and all(command.record.visible is False for command in commands)
        if not unseen and not any(command.record.refusal for command in commands):
            try:
                self._drive(found)
            except MotionRefused as error:
                found.note(list(found.commands), str(error))
        return found

    # -- driving and measuring -----------------------------------------------------------------------------------------

    def _drive(self, found: Findings) -> None:
        """Drive and measure, first with the compensated commands, arriving as in work.

        Arriving from the nominal commands, the joints would move by less than their backlash, which would stay open.
        """
        states, sent = self._go("compensated", found)
        found.driven = {name: (q, self.mover.approach[name].astype(np.float64)) for name, q in sent.items()}
        if not self.verify:
            return
        found.rounds.append(self._measure("compensated", found, states, sent))
        if not found.rounds[0]:  # the nominal command, a millimetre away, would not be measured either
            return
        if found.corrected:
            self._correct(found, states)
        if all(command.record.q_nominal is not None for command in found.commands.values()):
            found.nominal = self._measure("nominal", found, *self._go("nominal", found))

    def _go(self, kind: CommandKind, found: Findings) -> tuple[States, Mapping[str, Vector]]:
        """Drive all arms of a target to their commands of one kind; return their states and the sent positions."""
        nominal = kind == "nominal"
        records = {name: one.record for name, one in found.commands.items()}
        q = {name: np.array(one.q_nominal if nominal else one.q_compensated) for name, one in records.items()}
        if nominal:
            return drive_to(self.mover, q, {}), q
        sides, sent = self._sides(found), dict[str, Vector]()

        def command(name: str, start: Vector) -> Vector:
            here = arrival(q[name], start, sides.get(name))
            sent[name] = with_approach(self.model.arms[name], q[name], here, found.commands[name].conditions)
            return sent[name]

        return drive_to(self.mover, q, sides, command=command), sent

    def _sides(self, found: Findings) -> dict[str, Vector]:
        """Return the sides from which arms arrive: as stated; else, if they matter to the model, those of the way.

        The last motion is then short, as at most stops of a plan: effects that depend on its size are known there.
        """
        here = self.mover.positions()
        sides = {}
        for name, command in found.commands.items():
            if command.stated_approach is not None:
                sides[name] = np.array(command.stated_approach, dtype=np.float64)
            elif last_motion_matters(self.model.arms[name]):
                sides[name] = np.sign(np.asarray(command.record.q_compensated) - here[name])
        return sides

    def _measure(self, kind: CommandKind, found: Findings, states: States, sent: Mapping[str, Vector]) -> Rest:
        """Measure the SMRs of arms at rest; an SMR that cannot be measured becomes a note of its arm."""
        rest: dict[str, Measured] = {}
        mover = self.mover
        for name, command in found.commands.items():
            nominal = kind == "nominal"
            wanted_M = command.nominal_M if nominal else command.expected_M
            if wanted_M is None or command.record.visible is False:
                continue
            dwell_s = conditions_of(command.target, name).dwell
            if dwell_s is not None:
                mover.rest(name, dwell_s)
            try:
                point = mover.measure(name, states[name].q)
            except TrackerError as error:
                found.note([name], str(error))
                if isinstance(error, TargetLost | WrongTarget):
                    found.lost[name] = str(error)
                continue
            rest[name] = Measured(
                sent=sent[name],
                q=point.q,
                approach=mover.approach[name].astype(np.float64),
                wanted_M=wanted_M,
                predicted_M=predict_at_rest(self.model, mover, name, states[name], point),
                point=point,
                repeatability_m=self.repeatability_m.get(name, 0.0),
                angle_M=measured_rotation(
                    self.model.arms[name], point, command.nominal_rotation_M if nominal else command.rotation_M
                ),
            )
        return rest

    # -- correcting ----------------------------------------------------------------------------------------------------

    def _correct(self, found: Findings, states: States) -> None:
        """Correct significant errors until noise explains the rest, they no longer shrink, or the rounds are used up.

        An error that noise does not explain is measured again before it is corrected: among many targets some show one
        by chance, and a correction by it would make them worse.
        """
        first = found.rounds[0]
        before_M: dict[str, Array] = {}
        for _ in range(self.rounds):
            last = found.rounds[-1]
            names = unexplained(last, list(last), before_M)
            if not names:
                return
            self.mover.hold()
            try:
                if len(found.rounds) == 1:
                    last = self._again(found, states, {name: one.sent for name, one in first.items()}, list(first))
                    if len(last) < len(first):
                        return
                    found.rounds[0] = last
                if not (names := unexplained(last, list(last) if len(last) == 2 else names, {}, _SIGNIFICANT)):
                    return
                corrected = {
                    name: corrected_command(self.model.arms[name], its.sent, its.error_M, first[name].sent)
                    for name, its in last.items()
                    if name in names
                }
                sent = {name: corrected.get(name, one.sent) for name, one in last.items()}
                now = self._again(found, states, sent, names)
            except MotionRefused as error:
                found.note(names, str(error))
                return
            before_M |= {name: last[name].noise_M for name in names}
            if len(now) < len(first):
                return
            found.rounds.append(now)
            if not is_better(now, found.rounds[found.best]):
                return
            found.best = len(found.rounds) - 1

    def _again(self, found: Findings, states: States, sent: Mapping[str, Vector], names: Sequence[str]) -> Rest:
        """Measure all arms again and return the means; empty if one cannot be measured.

        The arms in ``names`` approach their commands again for each repeat; the others stay at rest. Both arms of a
        pair are measured together. ``states`` is brought up to date.
        """
        sides = {name: found.rounds[0][name].approach for name in names}
        each: list[Rest] = []
        for _ in range(REPEATS):
            states |= _drive(self.mover, {name: sent[name] for name in names}, sides, *_STEPS_BACK_RAD)
            each.append(self._measure("compensated", found, states, sent))
            if len(each[-1]) < len(sent):
                return {}
        return {name: mean_of([rest[name] for rest in each]) for name in sent}


def last_motion_matters(arm: ArmModel) -> bool:
    """Return whether an effect of the model depends on the last motion of the joints."""
    variables = {variable for term in arm.effects for variable in EFFECTS[term.slug].variables}
    return not variables.isdisjoint({InputVariable.APPROACH, InputVariable.STEP})


# -- Correct a command by measurement: compute the next command from the measured error, and decide when to stop ------


FARTHEST_M = 0.01
"""Largest distance [m] of a corrected command from the model's own: an uncalibrated arm has smaller errors."""
_FARTHEST_RAD = 0.1
"""Largest joint change [rad]: a larger one means another branch or a singularity nearby."""
_POSE = 6
"""Degrees of freedom of a pose: an arm with fewer joints cannot keep its rotation while its position changes."""
REPEATS = 3
"""New measurements of a target before a correction and after one. The measurement that raised the fault does not count:
it was selected because it was large."""
_NOISE_95 = 7.815
"""95 % quantile of chi-squared with three degrees of freedom; a target above it is measured again."""
_SIGNIFICANT = (11.345, 2.576)
"""99 % quantiles of chi-squared and, two-sided, of the normal distribution; if the mean of new measurements is above
them, it is corrected."""
_ONE_SIDED_95 = 1.645
"""One-sided 95 % quantile of the normal distribution [standard deviations]."""
_FINEST_M = 1e-6
"""Least standard deviation of a coordinate [m]: no arm positions better, and it keeps a zero covariance regular."""


def corrected_command(arm: ArmModel, q: Array, error_M: Array, first_q: Array) -> Array:
    """Return the command (N,) [rad] that moves the SMR by ``-error_M`` (3,) [m] from where the command ``q`` puts it.

    Invert the calibrated model at the predicted position shifted by the error, on the same branch and with the same
    rotation of the flange. An arm that cannot keep the rotation, as one of five joints, moves its joints as little as
    possible. ``first_q`` (N,) is the command of the model without correction.

    Raises
    ------
    MotionRefused
        If the model does not reach the shifted position, or the command is too far from the model's own.
    """
    rotation_M, _ = arm.flange(q[None])
    aim_M = arm.predict(q[None]) - error_M
    found = invert(arm, aim_M, rotation_M, q[None])
    if not found.reached[0] and arm.geometry.joints < _POSE:
        found = invert(arm, aim_M, np.full((1, 3, 3), np.nan), q[None])
    if not found.reached[0]:
        raise MotionRefused("correction refused: the calibrated model does not reach the corrected position")
    corrected = found.q[0]
    far_m = float(np.linalg.norm(np.diff(arm.predict(np.stack([first_q, corrected])), axis=0)))
    far_rad = float(np.abs(corrected - first_q).max())
    if not (far_m <= FARTHEST_M and far_rad <= _FARTHEST_RAD):
        raise MotionRefused(
            f"correction refused: it leads {far_m * 1e3:.1f} mm and {np.degrees(far_rad):.1f} deg from the model's"
            f" command, at most {FARTHEST_M * 1e3:.0f} mm and {np.degrees(_FARTHEST_RAD):.1f} deg are allowed; look at"
            " the SMR, its mount and the tracker"
        )
    return np.asarray(corrected)


def unexplained(
    rest: Rest,
    names: Sequence[str],
    before_M: Mapping[str, Array],
    limits: tuple[float, float] = (_NOISE_95, NORMAL_95),
) -> list[str]:
    """Return the arms of ``names`` with an error that noise does not explain; all of them if only the distance has one.

    ``before_M`` is the covariance (3, 3) [m^2] of the measurement from which an arm's command was corrected. ``limits``
    are quantiles, of chi-squared for an arm and two-sided for the distance: by default those of 95 %.
    """
    noise_M = {name: one.noise_M + before_M.get(name, 0.0) for name, one in rest.items()}
    own = [name for name in names if not explained_by_noise(rest[name].error_M, noise_M[name], limits[0])]
    if own or len(rest) != 2:
        return own
    first, second = rest.values()
    line_M, together_M = second.wanted_M - first.wanted_M, sum(noise_M.values(), np.zeros((3, 3)))
    return (
        [] if distance_explained_by_noise(distance_error_m(first, second), line_M, together_M, limits[1]) else [*names]
    )


def is_better(now: Rest, before: Rest) -> bool:
    """Return whether a correction reduced the error by more than noise explains (95 %)."""
    noise_M = [one.noise_M for rest in (now, before) for one in rest.values()]
    sigma_m = float(np.sqrt(sum(np.linalg.eigvalsh(one)[-1] for one in noise_M) / len(now)))
    return rms_error_m(before) - rms_error_m(now) > _ONE_SIDED_95 * sigma_m


def explained_by_noise(error_M: Array, covariance_M: Array, limit: float = _NOISE_95) -> bool:
    """Return whether ``error_M`` (3,) [m] is within the 95 % region of the noise, or of another chi-squared ``limit``.

    ``covariance_M`` (3, 3) [m^2] is that of the error: tracker and repeatability of this measurement and, after a
    correction, of the measurement that it was computed from. The squared Mahalanobis length of a normal vector in three
    dimensions is chi-squared with three degrees of freedom.
    """
    covariance = covariance_M + _FINEST_M**2 * np.eye(3)
    return bool(error_M @ np.linalg.solve(covariance, error_M) <= limit)


def distance_explained_by_noise(error_m: float, line_M: Array, covariance_M: Array, limit: float = NORMAL_95) -> bool:
    """Return whether noise explains the distance error of two SMRs; ``line_M`` (3,) [m] leads from one to the other.

    ``covariance_M`` (3, 3) [m^2] is that of the vector between them.
    """
    along = line_M / np.linalg.norm(line_M)
    sigma_m = np.sqrt(along @ covariance_M @ along + _FINEST_M**2)
    return bool(abs(error_m) <= limit * sigma_m)


def push(
    profile: Profile,
    model: CellModel,
    commands: Sequence[Command],
    control: JobControl | None = None,
    *,
    verify: bool,
    rounds: int = 0,
    repeatability_m: Mapping[str, float] | None = None,
    judge: Judge | None = None,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    visited: list[Findings] | None = None,
) -> VerifyResult:
    """Send every command to its arm, the other arms at home; if ``verify``, drive both commands and measure.

    The two arms of a cooperative target go there together and are measured while both rest. ``rounds`` is the maximum
    number of corrections of the remaining error. ``repeatability_m`` is the standard deviation of a coordinate of each
    arm's SMR over repeated motions [m], zero if unknown; smaller errors are not corrected.

    ``judge`` decides on tolerances; if None, by the profile alone. ``opened`` is called with the open cell before
    anything moves; an exception from it ends the job. ``confirm`` is called before the first motion. Each target
    is added to ``visited`` when it is done: the caller has them if the job is stopped.

    Raises
    ------
    InputError
        If no target can be commanded, or commands, model and profile are of different arms or SMR mounts.
    HardwareError
        If an arm or the tracker fails; all arms have been stopped.
    Stopped, Aborted
        On request; the arms have been braked.
    """
    control, visited = control or JobControl(), [] if visited is None else visited
    require_same_arms(profile, model, commands)
    if not any(command.record.q_compensated is not None for command in commands):
        raise InputError("push: none of the targets can be commanded: " + commands[0].record.refusal)
    by_target = grouped((command.target.name, command) for command in commands)
    judge, agreement, total, stopped = judge or Judge(profile), Agreement(), len(by_target), ""
    with moving_cell(profile, model, control, confirm=confirm, opened=opened) as mover:
        visit = TargetVisit(
            model=model, mover=mover, verify=verify, rounds=rounds, repeatability_m=repeatability_m or {}
        )
        if verify:
            records = [one.record for one in commands]
            sent = [{one.arm: np.array(q)} for one in records for q in (one.q_nominal, one.q_compensated) if q]
            tell_time(control, "push", profile, visits_s(profile, sent), 0, total)
        for done, (name, own) in enumerate(by_target.items()):
            mover.hold()
            mover.slow_start(done)
            control.tell("push", done, total, name)
            found = visit.to(own)
            visited.append(found)
            agreement.add(found.contradictions())
            if stopped := agreement.broken(ended=done + 1 == total):  # measurements contradict the model
                break
        mover.go_home()
    control.tell("push", total, total, "done")
    return result_of(visited, judge, stopped, verify=verify)
