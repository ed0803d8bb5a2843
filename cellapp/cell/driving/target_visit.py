"""Visit one target: drive its arm or arms there with each command, measure at rest, and correct the remaining error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.cell.driving.driving_targets import Driver, arrival
from cellapp.cell.driving.measured_correction import (
    REPEATS,
    CorrectionRefused,
    corrected_command,
    is_better,
    not_explained,
    significant,
)
from cellapp.cell.driving.motion import MotionRefused, Vector
from cellapp.cell.driving.verification import (
    CommandKind,
    Findings,
    Measured,
    Rest,
    mean_of,
    measured_turn,
    predict_at_rest,
)
from cellapp.cell.targets.command import Command
from cellapp.cell.targets.invert import with_approach
from cellapp.cell.targets.working_conditions import conditions_of
from cellapp.ground.control import JobControl
from cellapp.robot.effects import EFFECTS, DriverVariable
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from drivers.arms.protocol import ArmState
from drivers.trackers.protocol import TargetLost, TrackerError, WrongTarget

States = Mapping[str, ArmState]

_UNSEEN = "not measured: the tracker does not see the SMR there"


@dataclass(frozen=True)
class TargetVisit:
    """Visits targets with the arms of an open cell; the parameters are those of ``push``.

    ``hold`` is called between motions: it waits while a person pauses.
    """

    model: CellModel
    driver: Driver
    control: JobControl
    hold: Callable[[], None]
    verify: bool
    rounds: int
    repeatability_m: Mapping[str, float]

    def to(self, commands: Sequence[Command]) -> Findings:
        """Visit one target with the command of each of its arms.

        A refused motion, measurement or correction becomes a note; what stops the cell raises an exception.
        """
        found = Findings({command.arm: command for command in commands}, corrected=self.rounds > 0)
        for name, command in found.commands.items():
            partners = [f"arm {one.arm}: {one.refusal}" for one in commands if one is not command and one.refusal]
            if command.refusal:
                found.note([name], command.refusal)
            elif partners:
                found.note([name], "; ".join(partners))
            elif self.verify and command.visible is False:
                found.note([name], _UNSEEN)
        unseen = self.verify and all(command.visible is False for command in commands)
        if not unseen and not any(command.refusal for command in commands):
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
        mover = self.driver.mover
        found.driven = {name: (q, mover.approach(name).astype(np.float64)) for name, q in sent.items()}
        if not self.verify:
            return
        found.rounds.append(self._measure("compensated", found, states, sent))
        if not found.rounds[0]:  # the nominal command, a millimetre away, would not be measured either
            return
        self._correct(found, states)
        if all(command.q_nominal is not None for command in found.commands.values()):
            found.nominal = self._measure("nominal", found, *self._go("nominal", found))

    def _go(self, kind: CommandKind, found: Findings) -> tuple[States, Mapping[str, Vector]]:
        """Drive all arms of a target to their commands of one kind; return their states and the sent positions."""
        sent: dict[str, Vector] = {}
        sides = {} if kind == "nominal" else self._sides(found)

        def command(name: str, start: Vector) -> Vector:
            one = found.commands[name]
            sent[name] = np.asarray(one.q_nominal if kind == "nominal" else one.q_compensated)
            if kind == "compensated":
                here = arrival(sent[name], start, sides.get(name))
                sent[name] = with_approach(self.model.arms[name], sent[name], here, one.conditions)
            return sent[name]

        return self.driver.to(list(found.commands), command, sides), sent

    def _sides(self, found: Findings) -> dict[str, Vector]:
        """Return the sides from which arms arrive: as stated; else, if they matter to the model, those of the way.

        The last motion is then short, as at most stops of a plan: effects that depend on its size are known there.
        """
        here = self.driver.mover.positions()
        sides = {}
        for name, command in found.commands.items():
            if command.approach is not None:
                sides[name] = np.array(command.approach, dtype=np.float64)
            elif last_motion_matters(self.model.arms[name]):
                sides[name] = np.sign(np.asarray(command.q_compensated) - here[name])
        return sides

    def _measure(self, kind: CommandKind, found: Findings, states: States, sent: Mapping[str, Vector]) -> Rest:
        """Measure the SMRs of arms at rest; an SMR that cannot be measured becomes a note of its arm."""
        rest: dict[str, Measured] = {}
        mover = self.driver.mover
        for name, command in found.commands.items():
            nominal = kind == "nominal"
            wanted_M = command.nominal_M if nominal else command.expected_M
            if wanted_M is None or command.visible is False:
                continue
            dwell_s = conditions_of(command.target, name).dwell
            if dwell_s is not None:
                mover.rest(name, dwell_s, self.control)
            try:
                point = mover.measure(name, states[name].q)
            except TrackerError as error:
                found.note([name], str(error))
                if isinstance(error, TargetLost | WrongTarget):
                    found.lost[name] = str(error)
                continue
            rest[name] = Measured(
                sent=sent[name],
                q=states[name].q,
                approach=mover.approach(name).astype(np.float64),
                wanted_M=wanted_M,
                predicted_M=predict_at_rest(self.model, mover, name, states[name], point),
                point=point,
                repeatability_m=self.repeatability_m.get(name, 0.0),
                turn_M=measured_turn(
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
            names = not_explained(last, before_M)
            if not names:
                return
            self.hold()
            try:
                if len(found.rounds) == 1:
                    last = self._again(found, states, {name: one.sent for name, one in first.items()}, list(first))
                    if len(last) < len(first):
                        return
                    found.rounds[0] = last
                if not (names := significant(last, list(last) if len(last) == 2 else names)):
                    return
                corrected = {name: self._corrected(name, last, first) for name in names}
                sent = {name: corrected.get(name, one.sent) for name, one in last.items()}
                now = self._again(found, states, sent, names)
            except (CorrectionRefused, MotionRefused) as error:
                found.note(names, str(error))
                return
            before_M |= {name: last[name].noise_M for name in names}
            if len(now) < len(first):
                return
            found.rounds.append(now)
            if not is_better(now, found.rounds[found.best]):
                return
            found.best = len(found.rounds) - 1

    def _corrected(self, name: str, last: Rest, first: Rest) -> Vector:
        """Return the next command of an arm."""
        return corrected_command(self.model.arms[name], last[name].sent, last[name].error_M, first[name].sent)

    def _again(self, found: Findings, states: States, sent: Mapping[str, Vector], names: Sequence[str]) -> Rest:
        """Measure all arms again and return the means; empty if one cannot be measured.

        The arms in ``names`` approach their commands again for each repeat; the others stay at rest. Both arms of a
        pair are measured together.
        """
        sides = {name: found.rounds[0][name].approach for name in names}
        each: list[Rest] = []
        for _ in range(REPEATS):
            states = {**states, **self.driver.back_to({name: sent[name] for name in names}, sides)}
            each.append(self._measure("compensated", found, states, sent))
            if len(each[-1]) < len(sent):
                return {}
        return {name: mean_of([rest[name] for rest in each]) for name in sent}


def last_motion_matters(arm: ArmModel) -> bool:
    """Return whether an effect of the model depends on the last motion of the joints."""
    variables = {variable for term in arm.effects for variable in EFFECTS[term.slug].variables}
    return not variables.isdisjoint({DriverVariable.APPROACH, DriverVariable.STEP})
