"""Lost motion on reversal: backlash, hysteresis and friction wind-up."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import EffectColumn, EffectContext, joint_column, varies
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, ImpossibleValues, Meaning
from cellapp.robot.effects.law import (
    AMPLITUDE,
    FIXED,
    SCALED,
    Constant,
    InputVariable,
    Law,
    LawForm,
    SmoothLaw,
    with_prior_sd,
)
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.kinematics.transforms import Array

WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Steps [rad] after which hysteresis may be saturated: 1 to 45 degrees, a factor of 2 to 2.5 apart."""
_MOST_PLAY = 5e-3
"""Largest plausible half play [rad]: ten times the worst published lost motion of such gears."""
_MOST_WINDUP = 1e-4
"""Largest plausible wind-up [rad/Nm]: fifty times the estimated one."""

WIDTH = Constant("width", "rad", SCALED, "saturated beyond some {} deg", factor=float(np.degrees(1.0)))
TYPICAL_STEP = Constant("step", "rad", FIXED, per_joint=True)
"""Median step of the run, for stops whose step is unknown."""
CONSTANT = LawForm("constant", "the same after any motion")
SATURATING = LawForm("saturating", "taken up only by large steps", (WIDTH, TYPICAL_STEP))
SMALL = LawForm("smooth", "taken up only by large steps, small by prior", (WIDTH, TYPICAL_STEP, AMPLITUDE))
REACH = Constant("reach", "rad", FIXED, "over {}", "{} deg by joint {}", float(np.degrees(1.0)), per_joint=True)
"""Travel after a reversal over which a part of the lost motion changes to 1/e."""
BELL = Constant("bell_reach", "rad", FIXED, "as a bell over {}", REACH.each, REACH.factor, per_joint=True)
"""The same where it changes like a bell curve: friction of slow motion (Stribeck)."""
LOAD_REACH = Constant("load_reach", "rad", FIXED, "under load over {}", REACH.each, REACH.factor, per_joint=True)
LOAD_BELL = Constant("load_bell_reach", "rad", FIXED, "under load as a bell over {}", REACH.each, REACH.factor, True)
GRADUAL = LawForm("gradual", "in part taken up gradually", (REACH, BELL))
LOAD = LawForm("load", "in proportion to the load")
BOTH = LawForm("both", "dry friction, and in proportion to the load")
BOTH_GRADUAL = LawForm(
    "gradual", "dry and under load, in part built up gradually", (REACH, BELL, LOAD_REACH, LOAD_BELL)
)


_USUAL_WIDTH = 0.03
"""Step [rad] beyond which lost motion is taken as complete, where no law says otherwise: below the steps of nearly all
runs, so that stops after larger steps than the run had are not given more of it than was measured."""


class Backlash(Effect):
    """The joint lags half the play behind its last motion: ``dq_j = -h_j s_j``, s_j = +1 or -1, h_j > 0 [rad].

    Laws
    ----
    constant
        Any motion takes up all of the play.
    saturating
        ``dq_j = -h_j s_j tanh(|step_j| / w)``: hysteresis that a small step does not take up; w is searched. An
        unknown step counts as the run's median step of that joint.

    gradual
        ``dq_j = -s_j (h_j + f_j exp(-|step_j| / r_j))``: as recordings of motion show it, with a reach r_j of each
        joint, or with ``exp(-(step_j / r_j)^2)``; an unknown step counts as a long one.
    smooth
        As ``saturating``, each half play small by prior, of either sign.

    Size: strain-wave gears are specified in arc minutes of lost motion (sourced), h some 10 to 150 µrad; 40 µrad are
    25 to 55 µm at a UR10's flange. 90 % visible with stops approached from both sides; from one side only it hides in
    the joint zero. Confounded: unsettled measurement where sign and step are correlated, friction wind-up.
    """

    slug = "backlash"
    wears = True
    title = "backlash or hysteresis of joints"
    arm_bound = True
    meaning = Meaning.of(
        """cause: The gear of {place} has lost motion: the output lags behind the motor on each reversal.
        size (estimate): 40 µrad of half play are 25 to 55 µm at the flange of a UR10
        check: With drives on and the arm at rest, push and pull at the link beyond {place} with a dial gauge on it:
          play is a loose bolt or a worn gear. With drives off the brake's own play shows as well.
        check: Check the bolts of the gearbox of {place}, then have the gear inspected; until then approach every target
          from the side of the calibration.
        settle: Measure 10 poses twice, each joint approached once from either side by the same step.
        settle: Approach one pose with last steps of 1, 5, 20 and 60 degrees: hysteresis grows with the step, play does
          not.
        settle: Record approach signs, or import with --in-order."""
    )
    confounded = ("friction_windup", "unsettled_measurement")
    impossible = ImpossibleValues(
        sign="backlash of the opposite sign", sign_check="check the approach convention of the readings"
    )
    variables = frozenset({InputVariable.APPROACH, InputVariable.STEP})
    forms = (CONSTANT, SATURATING, GRADUAL, SMALL)
    discrepancy_inputs = (
        TermInput(Quantity.STEP, absolute=True),
        TermInput(Quantity.TORQUE, absolute=True),
        TermInput(Quantity.JOINT_ANGLE),
        TermInput(Quantity.TIME),
    )

    def missing_data(self, context: EffectContext) -> str:
        """Needs approaches from both sides."""
        return missing_for_lost_motion(context)

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Lost motion that is complete after a small step."""
        steps = np.full(context.joints, 10.0 * _USUAL_WIDTH)  # where no step is known, one that takes up all play
        if context.conditions.step is not None:
            steps = np.median(np.abs(context.step), axis=0)
        typical = {TYPICAL_STEP.key(j): size for j, size in enumerate(steps.tolist())}
        return [SmoothLaw("smooth", 5e-5, {WIDTH.name: _USUAL_WIDTH, **typical})]

    def laws(self, context: EffectContext) -> list[Law]:
        """Constant; saturating where steps are known."""
        if not varies(context.conditions.step):
            return [CONSTANT.law()]
        medians = np.median(np.abs(context.step), axis=0).tolist()
        typical = {TYPICAL_STEP.key(j): size for j, size in enumerate(medians)}
        return [CONSTANT.law(), *(SATURATING.law({WIDTH.name: w, **typical}, len(WIDTHS)) for w in WIDTHS)]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint; zero where the side of approach is unknown."""
        lag = -context.approach
        if law.form in (SATURATING, SMALL):
            lag = lag * np.tanh(_step_sizes(context, law) / law.constants[WIDTH.name])
        columns = [
            column
            for j in range(context.joints)
            for column in _gradual(context, law, (REACH, BELL), j, "half_play", "rad", lag[:, j], _MOST_PLAY)
        ]
        if law.form == SMALL:
            return [with_prior_sd(column, law.constants[AMPLITUDE.name]) for column in columns]
        return columns


def _gradual(
    context: EffectContext,
    law: Law,
    reaches: tuple[Constant, Constant],
    joint: int,
    name: str,
    unit: str,
    lag: Array,
    most: float,
) -> list[EffectColumn]:
    """Column of lost motion of one joint, which lags by ``lag`` (n,) per unit, and of the part that the last motion has
    left, where the law has one of ``reaches`` for it, the second as a bell curve."""
    found = [joint_column(f"{name}{joint + 1}", unit, joint, lag, 0.0, most)]
    for reach in reaches:
        if reach.key(joint) not in law.constants:
            continue
        share = share_after_motion(context.step[:, joint], law.constants[reach.key(joint)], bell=reach is reaches[1])
        found.append(joint_column(f"fresh_{name}{joint + 1}", unit, joint, lag * share, -most, most, refines=True))
    return found


def share_after_motion(step: Array, reach: float, *, bell: bool = False) -> Array:
    """Share (n,) of gradual lost motion that a joint has not taken up after a last motion ``step`` (n,) [rad] from the
    middle; none where the motion is unknown, zero or NaN. ``reach`` in rad; ``bell``: it falls like a bell curve."""
    size = np.abs(np.nan_to_num(step))
    return np.where(size > 0.0, np.exp(-((size / reach) ** (2 if bell else 1))), 0.0)


def _step_sizes(context: EffectContext, law: Law) -> Array:
    """Size of each joint's last step (n, N) [rad]; the run's median where unknown."""
    typical = np.array([law.constants.get(TYPICAL_STEP.key(j), np.inf) for j in range(context.joints)])
    step = context.conditions.step
    if step is None:
        return np.broadcast_to(typical, context.q.shape)
    return np.where(np.isnan(step), typical, np.abs(step))


class FrictionWindup(Effect):
    """Friction under load winds the drive up against the last motion: ``dq_j = -s_j (f_j + w_j |tau_j|)``.

    Laws
    ----
    load
        ``w_j`` alone [rad/Nm].
    both
        Dry friction ``f_j`` [rad] as well.
    gradual
        As ``both``, with a part of either that changes over the last motion as that of backlash does.

    Size: 1e-4 rad at 50 Nm (2e-6 rad/Nm) are 50 to 130 µm at a UR10's flange (estimate, not sourced). 80 % visible with
    stops approached from both sides under different loads. Confounded: backlash (0.7 of what is visible; a payload
    change distinguishes them), unsettled measurement.
    """

    slug = "friction_windup"
    title = "friction wind-up of joints"
    arm_bound = True
    meaning = Meaning.of(
        """cause: Friction in {place} holds the gear wound up against its last motion, more so under load.
        size (estimate): 1e-4 rad at 50 Nm, 50 to 130 µm at the flange of a UR10
        check: Warm the arm up: cold grease has more friction.
        check: Compare the motor current of {place} in slow motion with the other arm's.
        check: Check lubrication and brake of {place}: a dragging brake winds up too.
        settle: Approach the same poses from both sides with two payloads: wind-up grows with the load, backlash does
          not.
        settle: Push at the link with drives on and a dial gauge on it: play gives way at once, dry friction in
          proportion to the force."""
    )
    confounded = ("backlash", "unsettled_measurement")
    impossible = ImpossibleValues(
        sign="friction wind-up of the opposite sign",
        sign_check="check the approach convention of the readings",
        size_check="check masses",
    )
    variables = frozenset(
        {InputVariable.APPROACH, InputVariable.TORQUE, InputVariable.PAYLOAD, InputVariable.JOINT_ANGLE}
    )
    forms = (LOAD, BOTH, BOTH_GRADUAL)
    discrepancy_inputs = (
        TermInput(Quantity.TORQUE, absolute=True),
        TermInput(Quantity.STEP, absolute=True),
        TermInput(Quantity.JOINT_ANGLE),
        TermInput(Quantity.TIME),
    )

    def missing_data(self, context: EffectContext) -> str:
        """Needs approaches from both sides."""
        return missing_for_lost_motion(context)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint, or two; zero where the side of approach is unknown."""
        loaded = -context.approach * np.abs(context.torques)
        columns: list[EffectColumn] = []
        for j in range(context.joints):
            if law.form != LOAD:
                dry = -context.approach[:, j]
                columns += _gradual(context, law, (REACH, BELL), j, "dry", "rad", dry, _MOST_PLAY)
            of_load = (LOAD_REACH, LOAD_BELL)
            columns += _gradual(context, law, of_load, j, "windup", "rad/Nm", loaded[:, j], _MOST_WINDUP)
        return columns


def missing_for_lost_motion(context: EffectContext) -> str:
    """What the readings lack to show lost motion; empty if some joint was approached from both sides."""
    if not context.approach.any():
        return "no approach signs"
    both = (context.approach > 0.0).any(axis=0) & (context.approach < 0.0).any(axis=0)
    return "" if both.any() else "every joint was approached from one side only"
