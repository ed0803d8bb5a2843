"""Text on the correction of a program: its assumptions, and its output on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cellapp.cell.programs.records import CorrectedTarget, CorrectResult
from cellapp.cell.programs.solving import Workplace, moved_by, true_flange
from cellapp.cell.programs.targets import ReadProgram
from cellapp.ground.counting import counted
from cellapp.ground.profile import Arm
from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.effects.law import DriverVariable
from cellapp.robot.kinematics.transforms import invert, rotation_vectors
from cellapp.robot.model import ArmModel

_UNKNOWN = {
    DriverVariable.TIME: "as at the end of the run",
    DriverVariable.AIR_TEMPERATURE: "at the temperature to which the model refers",
    DriverVariable.JOINT_TEMPERATURE: "at the temperature to which the model refers",
    DriverVariable.OTHER_ARM: "without the other arm's load",
    DriverVariable.DWELL: "after a long rest",
}

SIZES = (
    "moves and turns: by how much the pose of the TCP is corrected; sigma: standard uncertainty of a coordinate of the"
    " corrected TCP by the calibrated model, so that a corrected target is within 2 sigma in each coordinate with 95 %"
    " probability"
)
"""Explanation of the numbers of the table."""


def assumptions(
    place: Workplace, settings: Arm, read: ReadProgram, corrected: Sequence[CorrectedTarget]
) -> Iterator[str]:
    """Yield the conditions under which the corrected program is valid, as sentences."""
    arm = place.arm
    apart = invert(arm.nominal.T_M_B()) @ arm.geometry.T_M_B()
    turn = float(np.linalg.norm(rotation_vectors(apart[None, :3, :3])[0]))
    published = f"the published table of the {settings.type.model}, without a calibration of its own"
    own = f"its own calibration, checksum {settings.factory.checksum or 'unknown'}" if settings.factory else published
    yield f"controller: computes by {own}"
    yield (
        "base: poses are in the base frame of the controller's chain, as it was registered to the readings; the"
        f" calibrated arm's base is {np.linalg.norm(apart[:3, 3]) * 1e3:.3f} mm and {turn * 1e3:.3f} mrad from it"
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
    left = [term.slug for term in arm.effects if EFFECTS[term.slug].of_reading]
    return [f"not corrected, as it moves only the reading: {', '.join(left)}"] if left else []


def correct_lines(result: CorrectResult) -> list[str]:
    """Return what was written, what was assumed and what was refused, as lines."""
    done = sum(not one.reason for one in result.targets)
    refused = result.refused
    lines = [SIZES, f"arm {result.arm}: {counted(done, 'target')} corrected, {len(refused)} not"]
    lines += [f"  assumed {line}" for line in result.assumptions]
    lines += [f"{result.program}:{line}: {command}: {reason}" for line, command, reason in refused]
    lines += [
        f"{result.program}:{one.line}: {one.command}: left, {one.reason}" for one in result.left if not one.refused
    ]
    lines += result.notes
    return [*lines, "nothing was written" if result.out is None else f"written to {result.out}"]


def refusal(result: CorrectResult) -> str:
    """Return why nothing was written; empty if something was."""
    if result.out is not None:
        return ""
    lines = ", ".join(dict.fromkeys(str(line) for line, _, _ in result.refused))
    return (
        f"{result.program}: nothing was written: targets in line {lines} have no correction."
        " --partly writes the others and leaves these as they are"
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _unknown_conditions(place: Workplace, q: np.ndarray) -> Iterator[str]:
    """Yield the conditions that effects of the model depend on and that a program does not state."""
    arm = moved_by(place.arm)
    variables = {variable for term in arm.effects for variable in EFFECTS[term.slug].variables}
    if DriverVariable.APPROACH in variables and len(q):
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
        " its turn about that axis and its tilt"
    )
    last = arm.geometry.joints - 1
    places = [6 + 5 * last + place for place in (0, 3)]
    if arm.posterior is not None and set(places) <= set(arm.posterior.columns):
        return f"{text} are known as well as the controller's table is; the stated uncertainties hold that"
    return f"{text} are those of the controller's table, and the stated uncertainties do not hold their errors"
