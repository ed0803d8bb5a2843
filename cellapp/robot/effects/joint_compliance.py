"""Torsional compliance of joints and gears under gravity, of the arm itself and of its payload."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import EffectColumn, EffectContext, joint_column, varies
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, ImpossibleValues, Meaning
from cellapp.robot.effects.law import AMPLITUDE, SCALED, Constant, InputVariable, Law, LawForm, SmoothLaw
from cellapp.robot.effects.modulation import OWN_SIZE, TermInput
from cellapp.robot.kinematics.statics import without_rounding
from cellapp.robot.kinematics.transforms import Array

KNEES = (0.2, 0.35, 0.5, 0.65)
"""Where the stiffness may change, as fractions of the largest torque of the run."""
_GRAVITY = 9.81
"""Standard gravity [m/s^2]."""
_UNIT_TORQUE = 0.5 * _GRAVITY
"""Torque of 1 kg at half a metre [Nm]."""
_MOST_COMPLIANCE = 1e-3
"""Bound [rad/Nm]: K = 1e3 Nm/rad is a tenth of the softest catalogue drive."""
_MOST_CORRECTION = 1e-4
"""Bound of what the load or one body adds to the compliance [rad/Nm], either sign."""
_MOST_AWAY = 0.3
"""Distance [m] by which the load's centre of mass may differ from the stated one."""
_LOADED = frozenset({InputVariable.JOINT_ANGLE, InputVariable.TORQUE, InputVariable.PAYLOAD})

KNEE = Constant("knee", "Nm", SCALED, "knee at {}", "{} Nm for joint {}", per_joint=True)
LINEAR = LawForm("linear", "in proportion to the torque, a stiffness each")
FREE_MASSES = LawForm("smooth", "in proportion to the torques of masses that are free", (AMPLITUDE,))
SECOND_KNEE = Constant("second_knee", "Nm", SCALED, "second knee at {}", "{} Nm for joint {}", per_joint=True)
TWO_SLOPE = LawForm("two_slope", "softer below a knee torque", (KNEE,))
THREE_SLOPE = LawForm("three_slope", "softer below each of two knee torques", (KNEE, SECOND_KNEE))
SOFTER = {KNEE: "soft", SECOND_KNEE: "middle"}
"""Names of the parameters below each knee, without the number of the joint."""


class JointCompliance(Effect):
    """Each joint deflects under the gravity torque on it: ``dq_j = c_j tau_j(q, payload)``, c_j = 1 / K_j > 0 [rad/Nm].

    Laws
    ----
    linear
        One stiffness per joint.
    two_slope
        ``dq_j = c_j tau_j + s_j clip(tau_j, -T_j, T_j)``: softer below a knee torque T_j, as catalogues of strain-wave
        gears show (K1 < K2 < K3).
    three_slope
        The same with a second knee, above the first, as those catalogues have. Recordings of motion show both.
    smooth
        ``dq_j = sum_i b_ji t_ji``, t_ji being the torque about joint j of 1 kg at the origin of frame i (the SMR for
        the last one): masses and stiffness are free, b_ji [rad/Nm] small by prior. Where nobody stated masses, or a
        load, also ``s_ji t_ji |t_ji| / 4.9 Nm``: drives stiffen, and no knee can be placed at a torque that nobody
        knows; and the torques of 1 kg beside the last axis: a tool's centre is anywhere.
    In all but the last, a correction of the torque of the load, or of one body, may be added at a joint: the load was
    weighed, the arm's own masses were not.

    Size: strain-wave drives of this class have K = 1e4 to 1e5 Nm/rad (Harmonic Drive CSG catalogue, ratio 1:50,
    sourced); times the torques of a UR10, 1 to 3 mm at its flange (computed). Visible with a range of q2, q3; a payload
    change distinguishes it from errors of the masses. Confounded: a bending link (nearly the same), one cycle per
    revolution (0.8 of what is visible), tilting pedestal.
    """

    slug = "joint_compliance"
    wears = True
    title = "joint compliance under gravity"
    arm_bound = True
    meaning = Meaning.of(
        """cause: Gear and bearings of {place} twist under the weight that they carry: strain-wave gears always, loose
          bolts or a worn gear more.
        size (computed): 1 to 3 mm at the flange of a UR10, 0.5 to 1.5 mm of a UR5
        check: Compare the value with that of the same joint of the other arm and of earlier runs. If it grew, check the
          bolts between the gearbox of {place} and both links.
        check: Check masses, centres of mass and payload in the profile and in the controller.
        settle: Repeat 20 stops with a second payload: what grows with the load is compliance and not geometry.
        settle: Log motor-side and output-side encoders: compliance shows in their difference, bending of a link does
          not."""
    )
    confounded = ("link_bending", "payload_compliance", "encoder_eccentricity", "pedestal_compliance")
    impossible = ImpossibleValues(
        sign="negative stiffness",
        sign_check="check masses, direction of gravity and mounting",
        size_check="check masses, direction of gravity and mounting",
    )
    variables = _LOADED
    forms = (LINEAR, TWO_SLOPE, THREE_SLOPE, FREE_MASSES)
    discrepancy_inputs = (OWN_SIZE, TermInput(Quantity.JOINT_ANGLE), TermInput(Quantity.PAYLOAD))

    def missing_data(self, context: EffectContext) -> str:
        """Needs masses."""
        return "" if context.torques.any() else "gravity loads no joint (no masses)"

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """The torque of gravity as it is, at any amplitude."""
        return [SmoothLaw("smooth", 1e-5)]

    def laws(self, context: EffectContext) -> list[Law]:
        """One stiffness; two with each knee."""
        largest = np.abs(context.torques).max(axis=0).tolist()
        knees = [
            TWO_SLOPE.law({KNEE.key(j): share * torque for j, torque in enumerate(largest)}, tried=len(KNEES))
            for share in KNEES
        ]
        return [LINEAR.law(), *knees]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint, and those that refine it: bodies, load, knee."""
        if law.form == FREE_MASSES:
            return _torques_of_unit_masses(context, law.constants[AMPLITUDE.name], names)
        columns = _corrections_by_body(context, names)
        loads = context.loads.torques_of(-1)
        for j, stiff in enumerate(_compliances("compliance", context.torques)):
            columns += [stiff, _correction(f"load{j + 1}", j, loads[:, j], f"load {j + 1}")]
            for knee, name in SOFTER.items():
                if knee in law.form.constants:
                    most = law.constants.get(knee.key(j), 0.0)
                    below = np.clip(context.torques[:, j], -most, most)
                    columns.append(_correction(f"{name}{j + 1}", j, below, f"knee {j + 1}", _MOST_COMPLIANCE))
        return columns


class PayloadCompliance(Effect):
    """Each joint deflects under the torque of the payload alone: ``dq_j = c_j tau_j(q, payload)`` [rad/Nm].

    The torque of a load whose centre of mass is d off the stated one along the flange's axes, ``c_j d`` in rad/N, may
    refine it at each joint.

    The deflection that comes and goes with the load in the gripper, of an arm whose own weight was calibrated away or
    is compensated by its controller. Size: 10 kg on a UR10 add 135 Nm at joint 2, 1.4 to 3.4 mm at the flange; 5 kg on
    a UR5 0.5 to 1.2 mm (computed from makers' tables and catalogue stiffness). Visible only where the payload varies;
    the same poses with two payloads separate it from all geometry. Confounded: joint compliance (the arm's own weight
    as well), a bending link.
    """

    slug = "payload_compliance"
    title = "joint compliance under the payload"
    arm_bound = True
    meaning = Meaning.of(
        """cause: The gear of {place} twists under the payload alone: the controller compensates the arm's own weight,
          or calibration did.
        size (computed): 10 kg deflect the flange of a UR10 by 1.4 to 3.4 mm, 5 kg that of a UR5 by 0.5 to 1.2 mm
        check: Weigh the payload and enter its mass and centre of mass in the profile and in the controller.
        check: Check that the payload is bolted tight.
        check: If the value is much above the other arm's, check the bolts at the gearbox of {place}.
        settle: Measure the same 10 poses empty and with two payloads."""
    )
    confounded = ("joint_compliance", "link_bending")
    impossible = ImpossibleValues(
        sign="negative stiffness under the payload",
        sign_check="check the payloads of the readings and the direction of gravity",
        size_check="check the payloads of the readings",
    )
    variables = _LOADED
    forms = (LawForm("", "in proportion to the payload's torque"),)
    discrepancy_inputs = (OWN_SIZE, TermInput(Quantity.JOINT_ANGLE), TermInput(Quantity.PAYLOAD))

    def missing_data(self, context: EffectContext) -> str:
        """Needs a payload that varies."""
        payload_kg = context.conditions.payload_kg
        if payload_kg is None or not np.isfinite(payload_kg).all():
            return "no payloads"
        return "" if varies(payload_kg) else "payload does not vary"

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint, and those that refine it: the load's centre of mass is not where it was stated."""
        return [*_compliances("payload_compliance", context.loads.torques_of(-1)), *_by_center_of_load(context)]


def _by_center_of_load(context: EffectContext) -> list[EffectColumn]:
    """``center_{x,y,z}{j}``: torque about joint j per metre that the load's centre is off along the flange's axes."""
    loads, rotations = context.loads, context.frames[0]
    weight = loads.masses[-1][:, None, None] * loads.gravity
    moments = np.cross(rotations[-1].swapaxes(1, 2), weight)  # (n, 3 axes of the flange, 3)
    torques = without_rounding(np.einsum("jna,nka->njk", rotations[:-1, :, :, 2], moments))
    most = _MOST_COMPLIANCE * _MOST_AWAY
    return [
        _correction(f"center_{letter}{j + 1}", j, torques[:, j, k], f"center of load {j + 1}", most, "rad/N")
        for j in range(context.joints)
        for k, letter in enumerate("xyz")
    ]


def _compliances(name: str, torques: Array) -> list[EffectColumn]:
    """One compliance per joint for torques (n, N) [Nm]."""
    return [
        joint_column(f"{name}{j + 1}", "rad/Nm", j, torques[:, j], 0.0, _MOST_COMPLIANCE)
        for j in range(torques.shape[1])
    ]


def _corrections_by_body(context: EffectContext, names: Collection[str] | None) -> list[EffectColumn]:
    """``moment{j}_{i}``: torque of body i alone about joint j; the payload counts to the last body."""
    masses, joints = context.bodies.masses, context.joints
    last = joints - 1
    wanted = [
        (j, i, name)
        for j in range(joints)
        for i in range(j, joints)
        for name in (f"moment{j + 1}_{i + 1}",)
        if (masses[i] != 0.0 or i == last) and (names is None or name in names)
    ]
    by_body = {i: context.loads.torques_of(i) for i in {i for _, i, _ in wanted}}
    if last in by_body:
        by_body[last] = by_body[last] + context.loads.torques_of(-1)
    return [_correction(name, j, by_body[i][:, j], name) for j, i, name in wanted]


def _torques_of_unit_masses(
    context: EffectContext, amplitude: float, names: Collection[str] | None
) -> list[EffectColumn]:
    """``unit{j}_{i}``: torque about joint j [Nm] of 1 kg at the origin of each later frame i (the last: SMR).

    ``bent{j}_{i}`` is its odd square over that of 1 kg at half a metre, where masses or the load are unknown;
    ``aside_x{j}``, ``aside_y{j}`` are torques by 1 kg that stands 0.5 m off the last axis.

    Without ``names`` those that are more than rounding: a single posture may have none about a joint of the model.
    """
    rotations, origins = context.frames
    weight_M = -_GRAVITY * context.up_M
    # else a knee at a known torque says it better
    nobody_stated = not context.bodies.masses.any() or not context.loads.masses[-1].any()
    columns = []
    for j in range(context.joints):
        axis = rotations[j][:, :, 2]
        for i in range(j + 1, context.joints + 1):
            place = context.p_M if i == context.joints else origins[i]
            torque = without_rounding(np.einsum("na,na->n", axis, np.cross(place - origins[j], weight_M)))
            if names is None and not torque.any():
                continue
            offsets = {f"unit{j + 1}_{i}": torque}
            if nobody_stated or names is not None:
                offsets[f"bent{j + 1}_{i}"] = torque * np.abs(torque) / _UNIT_TORQUE
            for name, offset in offsets.items():
                if names is None or name in names:
                    columns.append(_small(name, j, offset, amplitude))
        for k, letter in enumerate("xy") if nobody_stated or names is not None else ():
            if names is None or f"aside_{letter}{j + 1}" in names:
                moment = np.cross(0.5 * rotations[-1][:, :, k], weight_M)
                offset = without_rounding(np.einsum("na,na->n", axis, moment))
                columns.append(_small(f"aside_{letter}{j + 1}", j, offset, amplitude))
    return columns


def _small(name: str, joint: int, offset: Array, amplitude: float) -> EffectColumn:
    """A torque that is small by prior."""
    most = _MOST_COMPLIANCE
    return joint_column(name, "rad/Nm", joint, offset, -most, most, prior_sd=amplitude)


def _correction(
    name: str, joint: int, torque: Array, block: str, most: float = _MOST_CORRECTION, unit: str = "rad/Nm"
) -> EffectColumn:
    """A part of the torque that counts more or less than the rest."""
    return joint_column(name, unit, joint, torque, -most, most, block, refines=True)
