"""Compute the corrections of all targets of a program, or the reason why a target has none.

Text on the correction of a program: its assumptions, and its output on the terminal.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.programs.records import ArmPlace, CorrectedTarget, CorrectResult, ProgramTarget, ReadProgram
from cellapp.cell.programs.script_targets import six
from cellapp.cell.programs.urscript import pose_matrix, pose_numbers
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_stop
from cellapp.cell.targets.ranges import MARGIN
from cellapp.estimation.uncertainty.common import beyond, divided
from cellapp.estimation.uncertainty.records import CommonUncertainty
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.effects.law import InputVariable
from cellapp.robot.kinematics.chain import Geometry, flange_poses
from cellapp.robot.kinematics.inverse import Inverted, all_branches, errors_and_jacobian, newton, shifted_into
from cellapp.robot.kinematics.transforms import Array, invert, rotation_from_vector, rotation_vectors, transform
from cellapp.robot.model import ArmModel, CellModel

_RESIDUAL = 1e-6
"""Largest residual of the model [m, rad] at a corrected target."""
_LARGEST_ROTATION = 0.2
"""Correction of a joint [rad] above which a posture counts as singular. Away from singularities the deviations of an
arm, millimetres and milliradians, rotate its joints by some milliradians, a fortieth of this."""
_SAME = 1e-9
"""A correction below this [m, rad] is rounding; the text is not changed."""


@dataclass(frozen=True)
class Workplace:
    """Arm and conditions of a program.

    Attributes
    ----------
    arm : ArmModel
    limits : array, shape (N, 2)
        Joint limits [rad].
    home : array, shape (N,), or None
        Assumed position of the arm at the beginning [rad]; None if the profile has none.
    measured : array, shape (m, N)
        Joint positions of the readings [rad].
    seed : int
    payload_kg : float or None
        None if that of the model.
    extrapolate : bool
        Whether targets outside the joint ranges of the readings are corrected.
    """

    arm: ArmModel
    limits: Array
    home: Array | None
    measured: Array
    seed: int
    payload_kg: float | None
    extrapolate: bool

    def conditions(self, count: int) -> MeasurementConditions:
        """Return the known conditions of ``count`` targets: the payload."""
        payload = None if self.payload_kg is None else np.full(count, self.payload_kg)
        return MeasurementConditions(payload_kg=payload)


def solve_targets(place: Workplace, targets: Sequence[ProgramTarget]) -> list[CorrectedTarget]:
    """Return the correction of each target, in order."""
    if not targets:
        return []
    chain = controller_chain(place.arm)
    meant, chosen = _meant(place, chain, targets)
    results = [_refused(target, why) for target, (_, why) in zip(targets, chosen, strict=True)]
    found = [k for k, (q, _) in enumerate(chosen) if q is not None]
    if not found:
        return results
    q_old = np.array([chosen[k][0] for k in found])
    conditions = place.conditions(len(found))
    arm = moved_by(place.arm)
    solved = aim(arm, arm.nominal.T_M_B() @ meant[found], q_old, conditions)
    told = flange_of(chain, solved.q)
    tcps = [np.eye(4) if (tcp := targets[k].tcp) is None else pose_matrix(tcp) for k in found]
    for row, k in enumerate(found):
        residual = max(solved.residual_m[row], solved.residual_rad[row])
        if reason := _why_not(place, q_old[row], solved.q[row], residual):
            results[k] = _refused(targets[k], reason)
            continue
        results[k] = _corrected(
            targets[k],
            q_new=solved.q[row],
            meant=meant[k] @ tcps[row],
            told=told[row] @ tcps[row],
            nearest_to=chosen[k][1],
        )
    return results


def judged(
    place: Workplace, targets: Sequence[ProgramTarget], corrected: Sequence[CorrectedTarget], *, every: bool
) -> tuple[list[CorrectedTarget], list[CommonUncertainty]]:
    """Return the corrections with their uncertainties, and what is common to the targets of each TCP.

    A correction that is not significant against the target's own uncertainty is left as taught, unless ``every``; all
    are, if neither an own part nor what is common is significant. Else what is common moves all targets together.
    """
    found, common = list(corrected), list[CommonUncertainty]()
    any_significant = every
    solved = [(targets[k].tcp, k) for k, one in enumerate(corrected) if one.q_new is not None]
    for tcp, rows in grouped(solved).items():
        q = np.array([corrected[k].q_new for k in rows])
        point = np.zeros(3) if tcp is None else np.array(tcp[:3])
        parts = divided(
            place.arm, q, point, place.conditions(len(q)), place.measured, partial(_corrections, place, point), tcp
        )
        if parts is None:
            return found, common
        common.append(parts.common)
        any_significant |= parts.common.significant or parts.own_significant
        for row, k in enumerate(rows):
            own = {
                "uncertainty_mm": float(parts.whole_m[row]) * 1e3,
                "uncertainty_mrad": float(parts.whole_rad[row]) * 1e3,
                "own_mm": float(parts.own_m[row]) * 1e3,
                "own_mrad": float(parts.own_rad[row]) * 1e3,
            }
            found[k] = corrected[k].model_copy(update=own)
    for _, k in () if every else solved:
        one = found[k]
        sizes = (one.correction_mm, one.correction_mrad, one.own_mm, one.own_mrad)
        if not (any_significant and beyond(*(np.array(size, dtype=np.float64) for size in sizes))):
            found[k] = one.model_copy(update={"new": one.old, "significant": False})
    return found, common


def _corrections(place: Workplace, point: Array, q: Array, conditions: MeasurementConditions) -> tuple[Array, Array]:
    """Return by how much a plain controller at ``q`` (n, N) is told other than where the arm is: shift and rotation."""
    told = place.arm.nominal.T_M_B() @ flange_of(controller_chain(place.arm), q)
    true = true_flange(moved_by(place.arm), q, conditions)
    rotations = rotation_vectors(told[:, :3, :3] @ true[:, :3, :3].transpose(0, 2, 1))
    return told[:, :3, 3] - true[:, :3, 3] + (told[:, :3, :3] - true[:, :3, :3]) @ point, rotations


# -- inside -----------------------------------------------------------------------------------------------------------


def _meant(
    place: Workplace, chain: Geometry, targets: Sequence[ProgramTarget]
) -> tuple[Array, list[tuple[Array | None, str]]]:
    """Return the flange poses (n, 4, 4) in the base frame that targets mean, and a plain controller's joint positions.

    Each position comes with the name of what its solution is nearest to; None with the reason if there is none.
    """
    meant = np.tile(np.eye(4), (len(targets), 1, 1))
    poses = [k for k, target in enumerate(targets) if target.kind == "pose"]
    for k in poses:
        meant[k] = meant_flange(chain, targets[k])
    middle = np.mean([place.measured.min(axis=0), place.measured.max(axis=0)], axis=0)
    start = middle if place.home is None else place.home
    solutions = dict(zip(poses, branches(chain, meant[poses], place.limits, start, place.seed), strict=True))
    chosen: list[tuple[Array | None, str]] = []
    last, function, line = start, None, 0
    for k, target in enumerate(targets):
        if target.function != function:
            last, function, line = start, target.function, 0
        if target.kind == "joints":
            q: Array | None = np.array(target.numbers)
            meant[k] = meant_flange(chain, target)
            why = ""
        elif target.near is None and not line:
            q, why = _first_posture(place, solutions[k], middle)
        else:
            to = last if target.near is None else np.array(target.near)
            q = nearest(solutions[k], place.limits, to)
            why = "qnear" if target.near is not None else f"line {line}"
        chosen.append(
            (q, why if q is not None or len(solutions[k]) else "out of reach, or only beyond a joint's limits")
        )
        if q is not None:
            last, line = q, target.line
    return meant, chosen


def _first_posture(place: Workplace, solutions: Array, middle: Array) -> tuple[Array | None, str]:
    """Choose among solutions (k, N) [rad] of a target before which the program does not say where the arm is.

    The controller takes the one nearest to where the arm stands: at home, where the profile has it. Else it must be the
    only one within the ranges of the readings, or the only one. Return it and why, or None and why not.
    """
    shifted = [q for one in solutions if (q := nearest(one[None], place.limits, middle)) is not None]
    within = [q for q in shifted if not outside(q, place.measured)]
    if place.home is not None:
        at_home = nearest(solutions, place.limits, place.home)
        if at_home is not None and (len(within) != 1 or not outside(at_home, place.measured)):
            return at_home, "home"
    possible = within or shifted
    if len(possible) == 1:
        return possible[0], "readings" if within else "reach"
    where = "" if within else ", each outside the calibrated range"
    words = ", ".join(map(posture_text, possible))
    reason = f"{len(possible)} postures reach it{where}, {words} deg: say which by qnear or arms.*.home of the profile"
    return None, reason


def posture_text(q: Array | Sequence[float]) -> str:
    """Return joint positions (N,) [rad] in degrees."""
    return f"({', '.join(f'{angle + 0.0:.0f}' for angle in np.degrees(q).round())})"


def _why_not(place: Workplace, q_old: Array, q_new: Array, residual: float) -> str:
    """Return why a solution is not written; empty if it is."""
    low, high = place.limits[:, 0], place.limits[:, 1]
    for name, q in (("the program's", q_old), ("the corrected", q_new)):
        beyond = np.flatnonzero((q < low) | (q > high))
        if len(beyond):
            joint = int(beyond[0])
            return (
                f"{name} position of joint {joint + 1}, {np.degrees(q[joint]):.3f} deg, is beyond its limits"
                f" {np.degrees(low[joint]):.1f} to {np.degrees(high[joint]):.1f} deg"
            )
    rotation = np.abs(q_new - q_old)
    joint = int(rotation.argmax())
    if rotation[joint] > _LARGEST_ROTATION:
        return f"singular posture: its correction rotates joint {joint + 1} by {np.degrees(rotation[joint]):.1f} deg"
    if not residual < _RESIDUAL:
        return f"singular posture or edge of the reach: the calibrated arm stays {residual * 1e3:.3f} mm or mrad away"
    if not place.extrapolate and (joints := outside(q_new, place.measured)):
        joint = joints[0]
        low, high = place.measured.min(axis=0), place.measured.max(axis=0)
        return (
            f"outside the calibrated range: joint {joint + 1} at {np.degrees(q_new[joint]):.1f} deg, measured from"
            f" {np.degrees(low[joint]):.1f} to {np.degrees(high[joint]):.1f} deg (--extrapolate corrects it too)"
        )
    return ""


def _refused(target: ProgramTarget, reason: str) -> CorrectedTarget:
    return CorrectedTarget.like(target, old=target.numbers, reason=reason)


def _corrected(target: ProgramTarget, *, q_new: Array, meant: Array, told: Array, nearest_to: str) -> CorrectedTarget:
    shift = float(np.linalg.norm(told[:3, 3] - meant[:3, 3]))
    angle = float(np.linalg.norm(rotation_vectors((meant[:3, :3].T @ told[:3, :3])[None])[0]))
    new = six(q_new.tolist())
    if target.kind == "pose":
        pose = pose_numbers(told)
        rotation = target.numbers[3:] if target.position_only else nearest_vector(pose[3:], target.numbers[3:]).tolist()
        new = six([*pose[:3], *rotation])
    if shift < _SAME and angle < _SAME:
        new = target.numbers
    return CorrectedTarget.like(
        target,
        old=target.numbers,
        new=new,
        correction_mm=shift * 1e3,
        correction_mrad=angle * 1e3,
        q_new=six(q_new.tolist()),
        nearest_to=nearest_to,
    )


# -- Compute what to command a plain controller so that the real flange takes the pose that a program means -----------
#
# A plain controller computes with the published chain, or with its own calibration if the profile states it. A
# program's pose T is meant in the base frame of that chain, which is located in the cell by registration to the
# readings. With the calibrated model's true flange pose ``F(q)``:
#
#     q_new:  F(q_new) = T_M_base T_base_tcp inverse(T_flange_tcp)
#     T_new = K(q_new) T_flange_tcp                              K: forward kinematics of the controller
#
# Joint targets mean the pose that the controller computes for them.


_ROUNDS = 30
"""Maximum number of iterates of ``aim``: each gains two decades, fewer beside a singularity."""
_SAME_POSE = 1e-12
"""Residual [m, rad] at which that iteration ends: far below any controller's resolution."""


def meant_flange(chain: Geometry, target: ProgramTarget) -> Array:
    """Return the flange pose (4, 4) in the base frame that a target means."""
    if target.kind == "joints":
        flange: Array = flange_of(chain, np.array([target.numbers]))[0]
        return flange
    wanted = pose_matrix(target.numbers)
    if target.position_only and target.facing is not None:
        wanted[:3, :3] = rotation_from_vector(target.facing[3:])
    return wanted @ invert(pose_matrix(target.tcp or (0.0,) * 6))


def controller_chain(arm: ArmModel) -> Geometry:
    """Return the chain of a plain controller: nominal rows from its base to its flange."""
    return replace(arm.nominal.with_T_M_B(np.eye(4)), tool=np.zeros(3))


def flange_of(chain: Geometry, q: Array) -> Array:
    """Return flange poses (n, 4, 4) of a chain at ``q`` (n, N) [rad]."""
    rotations, origins = flange_poses(chain, q)
    return _poses(rotations, origins)


def moved_by(arm: ArmModel) -> ArmModel:
    """Return the model without effects that change only the tracker's reading."""
    effects = tuple(term for term in arm.effects if not EFFECTS[term.slug].of_reading)
    return replace(arm, effects=effects, posterior=None)


def true_flange(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> Array:
    """Return true flange poses (n, 4, 4) in the tracker frame if the controller reads ``q`` (n, N) [rad].

    Effects state displacements of points on the flange. Four points, the flange's origin and 1 m along each axis,
    give its rotation, too. The network knows only the SMR: it shifts the flange equally; where it learnt orientations,
    it also rotates the flange, about the SMR.
    """
    tools = (replace(arm.geometry, tool=point) for point in (np.zeros(3), *np.eye(3)))
    at = np.array([replace(arm, geometry=tool).predict(q, conditions=conditions) for tool in tools])
    rotations = np.stack([at[k + 1] - at[0] for k in range(3)], axis=2)
    u, _, vt = np.linalg.svd(rotations)
    rotations = u @ vt  # the nearest ones
    rotated = np.array([rotation_from_vector(one) for one in arm.angles_M(q)]).reshape(-1, 3, 3) @ rotations
    return _poses(rotated, at[0] + (rotations - rotated) @ arm.geometry.tool)


def aim(arm: ArmModel, wanted_M: Array, start: Array, conditions: MeasurementConditions) -> Inverted:
    """Find joint positions near ``start`` (n, N) at which the model puts the flange at ``wanted_M`` (n, 4, 4)."""
    chain = replace(arm.geometry, tool=np.zeros(3))

    def errors(rows: NDArray[np.intp], q: Array) -> tuple[Array, Array]:
        reached, wanted = true_flange(arm, q, conditions.take(rows)), wanted_M[rows]
        _, J = errors_and_jacobian(chain, wanted[:, :3, 3], wanted[:, :3, :3], q)
        rotation = rotation_vectors(wanted[:, :3, :3] @ reached[:, :3, :3].transpose(0, 2, 1))
        return np.concatenate([wanted[:, :3, 3] - reached[:, :3, 3], rotation], axis=1), J

    fixed = np.zeros(len(start), dtype=np.bool_)
    return newton(errors, start, fixed, rounds=_ROUNDS, same=_SAME_POSE, within=_RESIDUAL)


def branches(chain: Geometry, poses: Array, limits: Array, near: Array, seed: int) -> list[Array]:
    """Return for each of n flange poses (n, 4, 4) all joint positions (k, N) [rad] within limits (N, 2) that reach it.

    Of a chain without a closed form they are searched for from samples and from ``near`` (N,).
    """
    q = all_branches(chain, poses[:, :3, 3], poses[:, :3, :3], limits, near, seed)
    within = np.all(shifted_into(q, limits, np.zeros(chain.joints))[1] == 0.0, axis=2) & np.isfinite(q[:, :, 0])
    return [one[rows] for one, rows in zip(q, within, strict=True)]


def nearest(solutions: Array, limits: Array, to: Array) -> Array | None:
    """Return the solution (k, N) [rad], with whole turns within limits, nearest to ``to`` (N,) by the sum of squares.

    So does the controller (forum.universal-robots.com, "Get_inverse_kin closest solution criteria"). None without any.
    """
    if len(solutions) == 0:
        return None
    shifted, beyond = shifted_into(solutions, limits, to)
    shifted = shifted[np.all(beyond == 0.0, axis=1)]
    if len(shifted) == 0:
        return None
    return np.asarray(shifted[np.argmin(np.sum((shifted - to) ** 2, axis=1))])


def outside(q: Array, measured: Array) -> list[int]:
    """Return the indices of joints whose position in ``q`` (N,) is outside the readings (n, N), modulo whole turns."""
    low, high = measured.min(axis=0) - MARGIN, measured.max(axis=0) + MARGIN
    shifted = q + 2.0 * np.pi * np.ceil((low - q) / (2.0 * np.pi))
    return np.flatnonzero(shifted > high).tolist()


def nearest_vector(vector: Sequence[float], to: Sequence[float]) -> Array:
    """Return the rotation vector (3,) [rad] of the same rotation nearest to ``to``: it may differ by whole turns."""
    here, there = np.array(vector), np.array(to)
    angle = float(np.linalg.norm(here))
    if angle < 1e-9:
        return here
    axis = here / angle
    rotations = round((float(axis @ there) - angle) / (2.0 * np.pi))
    return np.asarray(axis * (angle + 2.0 * np.pi * rotations))


# -- inside -----------------------------------------------------------------------------------------------------------


def _poses(rotations: Array, origins: Array) -> Array:
    poses = np.tile(transform(np.eye(3), np.zeros(3)), (len(origins), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, origins
    return poses


# -- Write new numbers into the text of a program; everything else stays unchanged, byte for byte ---------------------


_DIGITS = 10
"""Digits after the decimal point: 0.1 nm and 0.1 nrad."""
_AGREE = 1e-9
"""If the new numbers [m, rad] for all uses of a variable differ by less, they are written at its assignment."""


def rewritten(text: str, targets: Sequence[ProgramTarget], corrected: Sequence[CorrectedTarget]) -> str:
    """Return the text with the new numbers of all targets that have some.

    Numbers of a variable change at its assignment if all its uses are targets with the same new numbers; otherwise they
    are written at each use.
    """
    edits: dict[tuple[int, int], str] = {}
    for target, result in zip(targets, corrected, strict=True):
        if result.new is None or result.new == result.old:
            continue
        if target.shared is not None and _agree(target.shared, targets, corrected):
            edits.update(_edits(target.shared, result.new, pose=target.kind == "pose"))
        elif target.as_joints and result.q_new is not None:
            edits.update(_edits(target.place, result.q_new, pose=False))
        else:
            edits.update(_edits(target.place, result.new, pose=target.kind == "pose"))
    for (start, end), new in sorted(edits.items(), reverse=True):
        text = text[:start] + new + text[end:]
    return text


def number_text(value: float) -> str:
    """Format a number as in programs, without an exponent."""
    text = f"{value:.{_DIGITS}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


# -- inside -----------------------------------------------------------------------------------------------------------


def _agree(shared: ArmPlace, targets: Sequence[ProgramTarget], corrected: Sequence[CorrectedTarget]) -> bool:
    """Return whether all uses of a variable have the same new numbers."""
    found = [result.new for target, result in zip(targets, corrected, strict=True) if target.shared == shared]
    known = [one for one in found if one is not None]
    return len(known) == len(found) and bool(np.ptp(np.array(known), axis=0).max() < _AGREE)


def _edits(place: ArmPlace, numbers: Sequence[float], *, pose: bool) -> dict[tuple[int, int], str]:
    texts = [number_text(value) for value in numbers]
    if place.numbers:
        return dict(zip(place.numbers, texts, strict=True))
    return {(place.start, place.end): f"{'p' if pose else ''}[{', '.join(texts)}]"}


# -- Warnings of the safety gate about the postures of a corrected program, which the gate does not drive -------------


def gate_findings(profile: Profile, model: CellModel, name: str, targets: Sequence[CorrectedTarget]) -> list[str]:
    """Return a sentence for each corrected target at which the gate would refuse the arm, the others at home.

    Motions between targets are not judged, because the controller computes blends and straight lines itself. If the
    profile does not describe the cell, one sentence says so.
    """
    if all(one.q_new is None for one in targets):
        return []
    homes = home_positions(profile)
    missing = [other for other in profile.arms if other != name and other not in homes]
    if missing:
        return [f"postures were not checked against the cell: arms.{missing[0]}.home is not in the profile"]
    try:
        cell = cell_bodies(profile, model)
    except InputError as error:
        return [f"postures were not checked against the cell: {error}"]
    postures = [(one, {**homes, name: np.array(one.q_new)}) for one in targets if one.q_new is not None]
    return [
        f"line {one.line}: {one.command}: with the other arms at home, {refusal}"
        for one, q in postures
        if (refusal := refuse_stop(cell, q))
    ]


_UNKNOWN = {
    InputVariable.TIME: "as at the end of the run",
    InputVariable.AIR_TEMPERATURE: "at the temperature to which the model refers",
    InputVariable.JOINT_TEMPERATURE: "at the temperature to which the model refers",
    InputVariable.OTHER_ARM: "without the other arm's load",
    InputVariable.DWELL: "after a long rest",
}

_ONLY = {"readings": "the only one within the ranges of the readings", "reach": "the only one that reaches it"}

SIZES = (
    "moves and turns: by how much the pose of the TCP is corrected; sigma: the target's own standard uncertainty of a"
    " coordinate of the TCP by the calibrated model, relative to the other targets; what is common to all stands below"
)
"""Explanation of the numbers of the table."""


def assumptions(
    place: Workplace, settings: Arm, read: ReadProgram, corrected: Sequence[CorrectedTarget]
) -> Iterator[str]:
    """Yield the conditions under which the corrected program is valid, as sentences."""
    arm = place.arm
    apart = invert(arm.nominal.T_M_B()) @ arm.geometry.T_M_B()
    rotation = float(np.linalg.norm(rotation_vectors(apart[None, :3, :3])[0]))
    published = f"the published table of the {settings.type.model}, without a calibration of its own"
    own = f"its own calibration, checksum {settings.factory.checksum or 'unknown'}" if settings.factory else published
    yield f"controller: computes by {own}"
    yield (
        "base: poses are in the base frame of the controller's chain, as it was registered to the readings; the"
        f" calibrated arm's base is {np.linalg.norm(apart[:3, 3]) * 1e3:.3f} mm and {rotation * 1e3:.3f} mrad from it"
    )
    tcps = dict.fromkeys(target.tcp for target in read.targets if target.tcp is not None)
    for tcp in tcps:
        yield f"TCP: p[{', '.join(f'{value:g}' for value in tcp)}] in the controller's flange frame"
    payload = arm.bodies.payload_mass if place.payload_kg is None else place.payload_kg
    source = "the profile" if place.payload_kg is None else "set_payload in the program"
    yield f"payload: {payload:g} kg, from {source}"
    q = np.array([one.q_new for one in corrected if one.q_new is not None])
    yield from _unknown_conditions(place, q)
    yield _orientation(arm)


def model_notes(arm: ArmModel) -> list[str]:
    """Report the effects of the model that a corrected program leaves out."""
    omitted = [term.slug for term in arm.effects if EFFECTS[term.slug].of_reading]
    return [f"not corrected, as it moves only the reading: {', '.join(omitted)}"] if omitted else []


def correct_lines(result: CorrectResult) -> list[str]:
    """Return what was written, what was assumed and what was refused, as lines."""
    done = sum(not one.reason for one in result.targets)
    refused = result.refused
    kept = sum(one.significant is False for one in result.targets)
    lines = [*[SIZES][:done], f"arm {result.arm}: {counted(done - kept, 'target')} corrected, {len(refused)} not"]
    if kept:
        lines.append(
            f"{counted(kept, 'target is', 'targets are')} left as taught: the correction is not significant against the"
            " target's own sigma (--insignificant corrects them too)"
        )
    lines += map(_common_words, result.common)
    lines += [f"  assumed {line}" for line in result.assumptions]
    lines += [
        f"{result.program}:{one.line}: {one.command}: posture {posture_text(one.q_new)} deg,"
        f" {_ONLY.get(one.nearest_to) or f'nearest to {one.nearest_to}'}"
        for one in result.targets
        if one.q_new is not None and one.kind == "pose"
    ]
    lines += [f"{result.program}:{line}: {command}: {reason}" for line, command, reason in refused]
    lines += [
        f"{result.program}:{one.line}: {one.command}: left, {one.reason}" for one in result.left if not one.refused
    ]
    lines += result.notes
    return [*lines, "nothing was written" if result.out is None else f"written to {result.out}"]


def _common_words(one: CommonUncertainty) -> str:
    """State what is common to the targets of a TCP, and what would determine it."""
    tcp = "of the flange" if one.tcp is None else f"of TCP p[{', '.join(f'{value:g}' for value in one.tcp)}]"
    against = f"what the corrections have in common is {'' if one.significant else 'not '}significant against it"
    return f"sigma common to all targets {tcp}: {one.sentence}; {against}"


_MOST_NAMED = 10
"""Most lines that a sentence names."""


def refusal(result: CorrectResult) -> str:
    """Return why nothing was written; empty if something was."""
    if result.out is not None:
        return ""
    lines = [*dict.fromkeys(str(line) for line, _, _ in result.refused)]
    more = f" and {len(lines) - _MOST_NAMED} more" if len(lines) > _MOST_NAMED else ""
    return (
        f"{result.program}: nothing was written: targets in line {', '.join(lines[:_MOST_NAMED])}{more} have no"
        " correction. --partly writes the others and leaves these as they are"
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _unknown_conditions(place: Workplace, q: np.ndarray) -> Iterator[str]:
    """Yield the conditions that effects of the model depend on and that a program does not state."""
    arm = moved_by(place.arm)
    variables = {variable for term in arm.effects for variable in EFFECTS[term.slug].variables}
    if InputVariable.APPROACH in variables and len(q):
        sides = [
            true_flange(arm, q, MeasurementConditions(approach=np.full(q.shape, side)))[:, :3, 3]
            for side in (-1.0, 1.0)
        ]
        most = np.linalg.norm(sides[1] - sides[0], axis=1).max() * 0.5e3
        yield f"approach: unknown, taken at the middle; coming from one side moves the flange by up to {most:.3f} mm"
    for variable, words in _UNKNOWN.items():
        slugs = [term.slug for term in arm.effects if variable in EFFECTS[term.slug].variables]
        if slugs:
            yield f"{variable.value}: {', '.join(dict.fromkeys(slugs))} taken {words}"


def _orientation(arm: ArmModel) -> str:
    """Describe what the readings determine of the flange's orientation."""
    text = (
        "orientation: readings of one point tell where the last joint's axis points, not how the flange sits on it:"
        " its rotation about that axis and its tilt"
    )
    last = arm.geometry.joints - 1
    places = [6 + 5 * last + place for place in (0, 3)]
    if arm.posterior is not None and set(places) <= set(arm.posterior.columns):
        return f"{text} are known as well as the controller's table is; the stated uncertainties hold that"
    return f"{text} are those of the controller's table, and the stated uncertainties do not hold their errors"
