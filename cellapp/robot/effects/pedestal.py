"""Pedestals that tilt under an arm: from the arm's own gravity moment, and from the other arm's."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, shift_column, varies
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, ImpossibleValues, Meaning
from cellapp.robot.effects.law import FIXED, Constant, InputVariable, Law, LawForm
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.effects.time_functions import with_default
from cellapp.robot.kinematics.transforms import Array

_LARGEST = 1e-5
"""Bound [rad/Nm, m/Nm]: a pedestal of 1e5 Nm/rad is as soft as a wooden table."""
_WEIGHTLESS = 1e-6
"""A moment that never exceeds this [Nm] is rounding error."""
_STEEP = 0.9
"""Vertical component of the base's x above which its y is the better horizontal direction."""

OWN_ISOTROPIC = LawForm("isotropic", "equally stiff both ways")
OWN_TILT = LawForm("tilt", "a stiffness for each way")
OWN_PIVOT = LawForm("pivot", "a stiffness for each way, about a point below the base")
OWN_GENERAL = LawForm("general", "tilt and shift in proportion to the arm's moment, each way")

MEAN_MOMENT = tuple(Constant(f"mean_{axis}", "Nm", FIXED) for axis in "xyz")
"""Mean moment of the other arm in the run, in this base: it is part of the identified base pose."""
OTHER_ISOTROPIC = LawForm("isotropic", "in proportion to the other arm's moment, equal both ways", MEAN_MOMENT)
OTHER_TILT = LawForm("tilt", "tilt in proportion to the other arm's moment, each way", MEAN_MOMENT)
OTHER_GENERAL = LawForm("general", "tilt and shift in proportion to the other arm's moment", MEAN_MOMENT)


class PedestalCompliance(Effect):
    """The base tilts under the arm's own gravity moment M about the base's origin: ``w = C M`` [rad/Nm].

    M is perpendicular to gravity, so only two of its components count, along x and y of an upright base.

    Laws
    ----
    isotropic
        ``w = c M``.
    tilt
        ``w_x = c_x M_x``, ``w_y = c_y M_y``.
    pivot
        The tilt is about points h_x, h_y below the base: its origin moves by ``w x (h z)`` as well, ``c h`` in m/Nm.
    general
        The tilt, and as refinements all that a frame does that is not symmetric: rotations across the moment and about
        the vertical [rad/Nm], shifts in any direction [m/Nm], and what the weight alone does about a pivot that is not
        below the base [rad/N, m/N].

    Size: 2e6 Nm/rad under 127 Nm is 60 µrad, 70 to 140 µm on a UR10 (stiffness is an estimate, moment computed). 36 %
    visible. Confounded: joint compliance (0.7 to 0.8), a bending link (0.6); an SMR on the pedestal shows it directly.
    """

    slug = "pedestal_compliance"
    title = "pedestal tilting under the arm's own weight"
    meaning = Meaning.of(
        """cause: The pedestal or the plate under the arm tilts under the arm's own weight as it reaches out.
        size (estimate): 2e6 Nm/rad under 127 Nm are 60 µrad, 70 to 140 µm on a UR10
        check: Tighten base plate and anchors, and look for a gap under the plate with a feeler gauge.
        check: Check that each levelling foot carries load.
        settle: Measure an SMR on top of the pedestal with the arm stretched to four sides."""
    )
    confounded = ("joint_compliance", "link_bending", "transmission_error", "tracker_angle_error")
    impossible = ImpossibleValues(
        sign="a pedestal that tilts away from the load",
        sign_check="check masses, direction of gravity and mounting",
        size_check="check masses, direction of gravity and mounting",
    )
    variables = frozenset({InputVariable.JOINT_ANGLE, InputVariable.TORQUE, InputVariable.PAYLOAD})
    forms = (OWN_ISOTROPIC, OWN_TILT, OWN_PIVOT, OWN_GENERAL)
    discrepancy_inputs = (TermInput(Quantity.TORQUE), TermInput(Quantity.JOINT_ANGLE))

    def missing_data(self, context: EffectContext) -> str:
        """Needs masses."""
        return "" if np.abs(context.loads.beyond(0)[1]).max(initial=0.0) > _WEIGHTLESS else "no masses"

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One, two or four columns in one block; in the general law thirteen more that refine."""
        axes = horizontal_axes(context)
        moments = _in_base(context, context.loads.beyond(0)[1]) @ axes.T
        tilted = [moments[:, k, None] * context.twist_shift(0, None, axis) for k, axis in enumerate(axes)]
        if law.form == OWN_ISOTROPIC:
            return [_own_column("pedestal_tilt", "rad/Nm", tilted[0] + tilted[1])]
        columns = [_own_column(f"pedestal_tilt_{by}", "rad/Nm", moved) for by, moved in zip("xy", tilted, strict=True)]
        if law.form == OWN_PIVOT:
            up = np.array([0.0, 0.0, 1.0])
            for k, by in enumerate("xy"):
                swayed = moments[:, k, None] * context.twist_shift(0, np.cross(axes[k], up), None)
                columns.append(_own_column(f"pedestal_sway_{by}", "m/Nm", swayed))
        if law.form == OWN_GENERAL:
            columns += _unsymmetric(context, moments, axes)
        return columns


def _unsymmetric(context: EffectContext, moments: Array, axes: Array) -> list[EffectColumn]:
    """Rotations across the own moment (n, 2) and about the vertical, and shifts, in a block of each kind."""
    x, y = axes
    tilts = [("x", "y", x), ("y", "x", y), ("z", "x", np.cross(x, y)), ("z", "y", np.cross(x, y))]
    moved = [(f"turn_{letter}_{by}", "rad/Nm", by, context.twist_shift(0, None, axis)) for letter, by, axis in tilts]
    moved += [
        (f"shift_{letter}_{by}", "m/Nm", by, context.base_twists[k]) for k, letter in enumerate("xyz") for by in "xy"
    ]
    weight = np.linalg.norm(context.loads.beyond(0)[0], axis=1)
    by_weight = [("x", "rad/N", context.twist_shift(0, None, x)), ("y", "rad/N", context.twist_shift(0, None, y))]
    by_weight.append(("z", "m/N", context.base_twists[2]))

    def column(name: str, unit: str, load: Array, shift_M: Array, block: str) -> EffectColumn:
        along = load[:, None] * shift_M
        return shift_column(f"pedestal_{name}", unit, ActsOn.BASE, along, -_LARGEST, _LARGEST, block, refines=True)

    return [
        *(
            column(name, unit, moments[:, "xy".index(by)], shift_M, f"base {name.split('_')[0]}s")
            for name, unit, by, shift_M in moved
        ),
        *(column(f"weight_{letter}", unit, weight, shift_M, "base weight") for letter, unit, shift_M in by_weight),
    ]


class PedestalCoupling(Effect):
    """The base tilts under the other arm's gravity moment, through the common foundation: ``w = C (M' - M'_mean)``.

    M' is the moment about the other base's origin, in this base's x and y; the mean of the run is part of the geometry.

    Laws
    ----
    isotropic
        ``w = c M'`` [rad/Nm].
    tilt
        All four of C: w_x and w_y for M'_x and M'_y.
    general
        The base also shifts along x, y, z [m/Nm].

    Size: 57 Nm of a UR5 are 28 µrad, 25 to 40 µm on a UR10; the UR10's moves the UR5 by 50 to 100 µm (stiffness is an
    estimate). 98 % visible where the other arm moves independently, nothing where it is parked. Confounded: none; a
    step of the base where the other arm is parked at a few poses in turn.
    """

    slug = "pedestal_coupling"
    title = "pedestal tilting under the other arm's weight"
    meaning = Meaning.of(
        """cause: The base tilts under the other arm's weight, through a common plate, frame or floor.
        size (estimate): 25 to 40 µm on a UR10 from a UR5's 57 Nm; 50 to 100 µm the other way round
        check: Tighten the bolts between both pedestals, their common frame and the floor.
        check: Park the other arm in the pose of the calibration where accuracy matters.
        settle: Move the other arm at random between stops, and log its joints."""
    )
    confounded = ("base_step", "base_drift")
    variables = frozenset({InputVariable.OTHER_ARM})
    forms = (OTHER_ISOTROPIC, OTHER_TILT, OTHER_GENERAL)
    discrepancy_inputs = (TermInput(Quantity.OTHER_JOINT_ANGLE),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs another arm that moves."""
        moment_M = context.conditions.other_moment_M
        if moment_M is None or not np.isfinite(moment_M).all():
            return "no readings of the other arm"
        return "" if varies(moment_M) else "the other arm did not move"

    def laws(self, context: EffectContext) -> list[Law]:
        """Isotropic; general tilt; shifts too."""
        moment_M = context.conditions.other_moment_M
        if moment_M is None:
            return []
        means = _in_base(context, moment_M).mean(axis=0).tolist()
        constants = {constant.name: mean for constant, mean in zip(MEAN_MOMENT, means, strict=True)}
        return [form.law(constants) for form in self.forms]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One, four or ten columns in one block; zero, as at the run's mean, where the other arm is unknown."""
        axes = horizontal_axes(context)
        moment_M = context.conditions.other_moment_M
        mean = np.array([law.constants[constant.name] for constant in MEAN_MOMENT])
        in_base = with_default(None if moment_M is None else _in_base(context, moment_M), mean, len(context)) - mean
        moments = in_base @ axes.T
        tilts = [context.twist_shift(0, None, axis) for axis in axes]
        if law.form == OTHER_ISOTROPIC:
            moved = moments[:, 0, None] * tilts[0] + moments[:, 1, None] * tilts[1]
            return [_other_column("coupling", "rad/Nm", moved)]
        moves = [(f"tilt_{letter}", "rad/Nm", moved) for letter, moved in zip("xy", tilts, strict=True)]
        if law.form == OTHER_GENERAL:
            moves += [(f"shift_{letter}", "m/Nm", context.base_twists[k]) for k, letter in enumerate("xyz")]
        return [
            _other_column(f"coupling_{name}_{by}", unit, moments[:, k, None] * moved)
            for name, unit, moved in moves
            for k, by in enumerate("xy")
        ]


def _own_column(name: str, unit: str, shift_M: Array) -> EffectColumn:
    """The arm's own moment tilts its base in the direction of the moment only."""
    return shift_column(name, unit, ActsOn.BASE, shift_M, 0.0, _LARGEST)


def _other_column(name: str, unit: str, shift_M: Array) -> EffectColumn:
    """The common foundation may tilt this base either way."""
    return shift_column(name, unit, ActsOn.BASE, shift_M, -_LARGEST, _LARGEST)


def horizontal_axes(context: EffectContext) -> Array:
    """Two horizontal unit vectors (2, 3) in the base frame: x and y of an upright base.

    The first is the base's x or, where that is steep, its y, without the component along gravity.
    """
    up = context.geometry.T_M_B()[:3, :3].T @ context.up_M
    first = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < _STEEP else np.array([0.0, 1.0, 0.0])
    first = first - (first @ up) * up
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


def _in_base(context: EffectContext, vectors_M: Array) -> Array:
    """Vectors (n, 3) of the tracker frame in the base frame."""
    return np.asarray(vectors_M @ context.geometry.T_M_B()[:3, :3])
