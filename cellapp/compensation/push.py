"""Push compensated targets to the arms and, with verification, measure where the SMR really goes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from cellapp.calibration.evaluation import summarise
from cellapp.collection.cell import Cell, open_cell
from cellapp.collection.collect import Opened
from cellapp.collection.motion import Confirm, MotionRefused, Mover
from cellapp.collection.supervision import hold_while_paused, reacting
from cellapp.compensation.compensate import Command, with_approach
from cellapp.compensation.tolerance import measured_verdict
from cellapp.control import JobControl
from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel
from cellapp.profile import Profile
from cellapp.progress import Listener, Progress, ignore
from cellapp.results import ArmVerification, MeasuredTarget, VerifyResult
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from drivers.trackers.protocol import TrackerError

CommandKind = Literal["nominal", "compensated"]


def push(
    profile: Profile,
    model: CellModel,
    commands: Sequence[Command],
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    verify: bool,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    open_with: Opened | None = None,
) -> VerifyResult:
    """Send every command to its arm, the other arms at home; with ``verify`` both commands, and measure.

    ``opened`` is called with the open cell before anything moves; what it raises ends the job. ``confirm`` is asked
    before the first motion. ``open_with`` opens the cell.

    Raises
    ------
    InputError
        If no target can be commanded at all.
    HardwareError
        If an arm or the tracker fails; all arms have been stopped.
    Stopped, Aborted
        On request; the arms have been braked.
    """
    control = control or JobControl()
    if not any(command.q_compensated is not None for command in commands):
        raise InputError("push: none of the targets can be commanded: " + commands[0].refusal)
    bodies = cell_bodies(profile, model)
    homes = home_positions(profile)
    measured: list[MeasuredTarget] = []
    kinds: tuple[CommandKind, ...] = ("nominal", "compensated") if verify else ("compensated",)
    with (open_with or open_cell)(profile) as cell, reacting(cell, control) as reaction:
        opened(cell)
        cell.require_tracker()
        mover = Mover(profile, cell, bodies, reaction)
        mover.confirm_first(homes, confirm)
        slow = profile.collection.slow_start
        slow_targets = slow.stops if profile.moves_hardware else 0
        mover.speed = slow.speed if slow_targets else 1.0
        mover.go_home()
        busy = ""
        for done, command in enumerate(commands):
            hold_while_paused(cell, control, reaction)
            mover.speed = slow.speed if done < slow_targets else 1.0
            listener(Progress("push", done, len(commands), command.target.name))
            name = command.arm
            if busy and busy != name:
                mover.move({busy: homes[busy]})
            busy = name
            measured.append(_push_target(mover, model.arms[name], command, kinds, homes[name], verify=verify))
        mover.go_home()
    listener(Progress("push", len(commands), len(commands), "done"))
    return VerifyResult(arms=_by_arm(measured), targets=tuple(measured))


def _push_target(
    mover: Mover, arm: ArmModel, command: Command, kinds: Sequence[CommandKind], home: Array, *, verify: bool
) -> MeasuredTarget:
    """Send one target's commands and measure each; a refused motion or measurement becomes the target's note."""
    errors_mm: dict[CommandKind, float] = {}
    q = measured_M = predicted_M = None
    note = command.refusal
    for kind in kinds if not note else ():
        try:
            here = _go_and_measure(mover, arm, command, kind, home, measure=verify)
        except (MotionRefused, TrackerError) as error:
            note = str(error)
            break
        expected_M = command.nominal_M if kind == "nominal" else command.expected_M
        if here is not None and expected_M is not None:
            q, measured_M = here
            predicted_M = arm.predict(q[None], mover.approach(command.arm)[None])[0]
            errors_mm[kind] = float(np.linalg.norm(measured_M - expected_M)) * 1e3
    target = command.target
    return MeasuredTarget(
        name=target.name,
        arm=command.arm,
        frame=target.frame,
        position=target.position,
        rpy=target.rpy,
        tolerance_mm=target.tolerance_mm,
        nominal_mm=errors_mm.get("nominal"),
        compensated_mm=errors_mm.get("compensated"),
        note=note,
        verdict=measured_verdict(errors_mm.get("compensated"), target.tolerance_mm),
        q=_tuple(q),
        measured_M=_tuple(measured_M),
        predicted_M=_tuple(predicted_M),
    )


def _go_and_measure(
    mover: Mover, arm: ArmModel, command: Command, kind: CommandKind, home: Array, *, measure: bool
) -> tuple[Array, Array] | None:
    """Move to a target and, with ``measure``, return the joint positions reached and the measured SMR in M [m]."""
    name = command.arm

    def joints() -> Array:
        if kind == "nominal":
            return np.asarray(command.q_nominal)
        return with_approach(arm, np.asarray(command.q_compensated), mover.positions()[name])

    # straight if the arm can return home from there, so that it is never stranded; else via home
    if mover.refusal({name: joints()}, {name: home}):
        mover.move({name: home})
    states = mover.move({name: joints()})
    if not measure:
        return None
    return states[name].q, mover.measure(name, states[name].q).p_M


def _tuple(vector: Array | None) -> Any:
    return None if vector is None else tuple(vector.tolist())


def _by_arm(targets: Sequence[MeasuredTarget]) -> Mapping[str, ArmVerification]:
    """Error statistics by arm, over the targets that were measured with both commands."""
    arms: dict[str, ArmVerification] = {}
    for name in dict.fromkeys(target.arm for target in targets):
        pairs = [
            (target.nominal_mm, target.compensated_mm)
            for target in targets
            if target.arm == name and target.nominal_mm is not None and target.compensated_mm is not None
        ]
        if pairs:
            nominal_m, compensated_m = np.array(pairs).T * 1e-3
            arms[name] = ArmVerification(nominal_mm=summarise(nominal_m), compensated_mm=summarise(compensated_m))
    return arms
