"""What stands under an arm gives way: to the arm's own moment, and to its neighbour's."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext, Law, shift_column, unknown_law, varies
from cellapp.effects.history import filled
from cellapp.kinematics.transforms import Array

_LARGEST = 1e-5
"""Generous: a pedestal of 1e5 Nm/rad is a wooden table [rad/Nm]."""


class PedestalCompliance:
    """The base tilts under the arm's own gravity moment M about the base's origin: ``w = C M`` [rad/Nm].

    M is square to gravity, so only two of its components count, along the base's x and y where it stands upright.

    Laws
    ----
    isotropic
        ``w = c M``.
    tilt
        ``w_x = c_x M_x``, ``w_y = c_y M_y``.
    pivot
        The tilt is about points h_x, h_y below the base: its origin moves by ``w x (h z)`` as well, ``c h`` in m/Nm.

    Size: 2e6 Nm/rad under 127 Nm is 60 urad, 70 to 140 um on a UR10 (stiffness is an estimate, moment computed). 36 %
    visible. Look-alikes: joint compliance (0.7 to 0.8), a bending link (0.6); an SMR on the pedestal shows it at once.
    """

    slug = "pedestal_compliance"
    title = "pedestal tilting under the arm's own weight"
    look_alikes: tuple[str, ...] = ("joint_compliance", "link_bending", "transmission_error", "tracker_angle_error")
    variables = frozenset({"q", "torque", "payload"})

    def untestable(self, context: EffectContext) -> str:
        """Needs masses."""
        return "" if np.abs(context.load_beyond(0)[1]).max(initial=0.0) > 1e-6 else "no masses"

    def laws(self, context: EffectContext) -> list[Law]:
        """The same both ways; each way; about a pivot."""
        return [Law("isotropic"), Law("tilt"), Law("pivot")]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One, two or four columns in one block."""
        ways = horizontal_ways(context)
        moments = _in_base(context, context.load_beyond(0)[1]) @ ways.T
        tilted = [moments[:, k, None] * context.twist_shift(0, None, way) for k, way in enumerate(ways)]
        if law.name in ("", "isotropic"):
            return [shift_column("pedestal_tilt", "rad/Nm", "base", tilted[0] + tilted[1], 0.0, _LARGEST)]
        if law.name not in ("tilt", "pivot"):
            raise unknown_law(self.slug, law)
        columns = [
            shift_column(f"pedestal_tilt_{letter}", "rad/Nm", "base", moved, 0.0, _LARGEST)
            for letter, moved in zip("xy", tilted, strict=True)
        ]
        if law.name == "pivot":
            columns += [
                shift_column(
                    f"pedestal_sway_{letter}",
                    "m/Nm",
                    "base",
                    moments[:, k, None] * context.twist_shift(0, np.cross(ways[k], [0.0, 0.0, 1.0]), None),
                    0.0,
                    _LARGEST,
                )
                for k, letter in enumerate("xy")
            ]
        return columns


class PedestalCoupling:
    """The base tilts under the other arm's gravity moment, through what both stand on: ``w = C (M' - M'_mean)``.

    M' is the moment about the other base's origin, seen in this base's x and y; the mean of the run is geometry.

    Laws
    ----
    isotropic
        ``w = c M'`` [rad/Nm].
    tilt
        All four of C: w_x and w_y for M'_x and M'_y.
    general
        The base also shifts along x, y, z [m/Nm].

    Size: 57 Nm of a UR5 are 28 urad, 25 to 40 um on a UR10; the UR10's moves the UR5 by 50 to 100 um (stiffness is an
    estimate). 98 % visible where the other arm moves independently, nothing where it is parked. Look-alikes: none; a
    step of the base where the other arm is parked at a few poses in turn.
    """

    slug = "pedestal_coupling"
    title = "pedestal tilting under the other arm's weight"
    look_alikes: tuple[str, ...] = ("base_step", "base_drift")
    variables = frozenset({"other_arm"})

    def untestable(self, context: EffectContext) -> str:
        """Needs an other arm that moves."""
        known = context.known.other_moment_M
        if known is None or not np.isfinite(known).all():
            return "the other arm's readings are not there"
        return "" if varies(known) else "the other arm did not move"

    def laws(self, context: EffectContext) -> list[Law]:
        """The same both ways; all of the tilt; shifts too."""
        known = context.known.other_moment_M
        if known is None:
            return []
        mean = _in_base(context, known).mean(axis=0).tolist()
        constants = {f"mean_{letter}": value for letter, value in zip("xyz", mean, strict=True)}
        return [Law(name, constants) for name in ("isotropic", "tilt", "general")]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One, four or ten columns in one block; zero, as at the run's mean, where the other arm is not known."""
        ways = horizontal_ways(context)
        known = context.known.other_moment_M
        mean = np.array([law.constants[f"mean_{letter}"] for letter in "xyz"])
        in_base = filled(None if known is None else _in_base(context, known), mean, len(context)) - mean
        moments = in_base @ ways.T
        tilts = [context.twist_shift(0, None, way) for way in ways]
        if law.name in ("", "isotropic"):
            moved = moments[:, 0, None] * tilts[0] + moments[:, 1, None] * tilts[1]
            return [shift_column("coupling", "rad/Nm", "base", moved, -_LARGEST, _LARGEST)]
        if law.name not in ("tilt", "general"):
            raise unknown_law(self.slug, law)
        moves = [(f"tilt_{letter}", "rad/Nm", moved) for letter, moved in zip("xy", tilts, strict=True)]
        if law.name == "general":
            moves += [(f"shift_{letter}", "m/Nm", context.base_twists[k]) for k, letter in enumerate("xyz")]
        return [
            shift_column(f"coupling_{name}_{by}", unit, "base", moments[:, k, None] * moved, -_LARGEST, _LARGEST)
            for name, unit, moved in moves
            for k, by in enumerate("xy")
        ]


def horizontal_ways(context: EffectContext) -> Array:
    """Two horizontal unit vectors (2, 3) in the base frame: its x and y where it stands upright.

    The first is the base's x or, where that is steep, its y, without the part along gravity.
    """
    up = context.geometry.T_M_B()[:3, :3].T @ context.up_M
    first = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = first - (first @ up) * up
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


def _in_base(context: EffectContext, vectors_M: Array) -> Array:
    """Vectors (n, 3) of the tracker frame in the base frame."""
    return np.asarray(vectors_M @ context.geometry.T_M_B()[:3, :3])
