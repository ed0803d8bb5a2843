"""Coulomb friction behind the drive's spring: the joint comes to rest wound up against the last motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    NOT_NEGATIVES,
    NUMBER,
    POSITIVE,
    STIFFNESSES,
    PlantEffect,
    Read,
    Situation,
    by_law,
    made,
)
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class TrueWindup(PlantEffect):
    """At rest the spring holds the friction torque ``friction + load_friction * |load|`` of the last motion.

    The friction acts at the joint, the encoder is at the motor. The load is gravity in the deflected posture. The
    wind-up does not exceed the last step; a joint that has not moved has none. Size: 1e-4 rad at 50 Nm (an estimate).
    """

    friction: Array
    load_friction: Array
    stiffness: Array

    def friction_torque(self, situation: Situation, load: Array) -> Array:
        """Return the friction torque (n, N) that the last motion leaves under a load torque (n, N), both in Nm."""
        torque: Array = self.friction + self.load_friction * np.abs(load)
        return torque

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        wound = self.friction_torque(situation, posture.torques) / self.stiffness
        step = np.abs(situation.last_step)
        return Deflection(joints=-situation.approach * np.where(step == 0.0, wound, np.minimum(wound, step)))


@dataclass(frozen=True, eq=False)
class StribeckWindup(TrueWindup):
    """Friction that rises as the motion slows down (Stribeck): short steps, which are slow, leave more of it.

    The friction torque is ``1 + rise exp(-(step / short)^2)`` times that of long steps, ``short`` in rad.
    """

    rise: float
    short: float

    def friction_torque(self, situation: Situation, load: Array) -> Array:
        slow: Array = 1.0 + self.rise * np.exp(-((situation.last_step / self.short) ** 2))
        # a step of zero means a long one
        slow = np.where(situation.last_step == 0.0, 1.0, slow)
        return slow * super().friction_torque(situation, load)


@dataclass(frozen=True, eq=False)
class RootLoadWindup(TrueWindup):
    """Friction that grows with the square root of the load, as of lubricated teeth: less than proportionally.

    ``friction + load_friction * sqrt(|load| * typical_load)``, ``typical_load`` [Nm] per joint.
    """

    typical_load: Array

    def friction_torque(self, situation: Situation, load: Array) -> Array:
        torque: Array = self.friction + self.load_friction * np.sqrt(np.abs(load) * self.typical_load)
        return torque


_PLAIN: Mapping[str, Read] = {**dict.fromkeys(("friction", "load_friction"), NOT_NEGATIVES), "stiffness": STIFFNESSES}

friction_windup = by_law(
    proportional=made(TrueWindup, **_PLAIN),
    stribeck=made(StribeckWindup, **_PLAIN, rise=NUMBER, short=POSITIVE),
    root_load=made(RootLoadWindup, **_PLAIN, typical_load=NOT_NEGATIVES),
)
"""Per joint: ``friction`` [Nm], ``load_friction`` [Nm/Nm], drive ``stiffness`` [Nm/rad].

Other laws: ``law`` stribeck with ``rise`` and ``short`` [rad]; root_load with ``typical_load`` [Nm] per joint.
"""
