"""Drifts and steps of the base, the tracker and the SMR's seat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    VECTOR,
    Factory,
    Offset,
    Parameters,
    PlantEffect,
    Read,
    Situation,
    by_law,
    made,
)
from drivers.plant.mechanism import Deflection
from drivers.plant.random_functions import RandomPaths
from drivers.plant.transforms import rigid, transform_points

_LAWS = ("linear", "exponential", "creep", "sinusoidal", "wandering")


@dataclass(frozen=True, eq=False)
class DriftCourse:
    """Course of a drift over time: linear (1 at ``time``), exponential (towards 1), logarithmic creep, and others.

    Creep is ``log(1 + t / time)``, as of a bolted joint that settles under a constant load. A sinusoidal drift, as with
    the sun on a wall, has the period ``time`` and starts at ``phase``. A wandering drift has a separate random path for
    each component of the twist, whose fastest wave has the period ``time``.
    """

    law: str
    time: float
    phase: float = 0.0
    paths: RandomPaths | None = None

    def share(self, time_s: Array) -> Array:
        """Return the shares of the full drift at times (n,) [s]: (n,), or (n, 6) of a wandering one."""
        if self.paths is not None:
            return self.paths.at(np.maximum(time_s, 0.0))
        t = np.maximum(time_s, 0.0) / self.time
        if self.law == "sinusoidal":
            swing: Array = np.sin(2.0 * np.pi * t + self.phase) - np.sin(self.phase)
            return swing
        shares: Array = {"linear": t, "exponential": -np.expm1(-t), "creep": np.log1p(t)}[self.law]
        return shares


def _scaled(share: Array, twist: Array) -> Array:
    """Return twists (n, 6) from shares (n,) or (n, 6)."""
    scaled: Array = (share if share.ndim == 2 else share[:, None]) * twist
    return scaled


@dataclass(frozen=True, eq=False)
class Slip:
    """Course of a slip at ``time`` [s]: the share ``creeping`` follows with ``time_constant`` [s], the rest at once."""

    time: float
    creeping: float = 0.0
    time_constant: float = 1.0

    def share(self, time_s: Array) -> Array:
        """Return the share (n,) of the slip at times (n,) [s]."""
        since = time_s - self.time
        remaining = self.creeping * np.exp(-np.maximum(since, 0.0) / self.time_constant)
        shares: Array = np.where(since >= 0.0, 1.0 - remaining, 0.0)
        return shares


def _base_moves(situation: Situation, twist: Array, course: DriftCourse | Slip) -> Deflection:
    """Return the deviation of a base that drifts or slips from its pose. Sizes: 10 to 50 um in a run (an estimate)."""
    return Deflection(base=_scaled(course.share(situation.time_s), twist))


@dataclass(frozen=True, eq=False)
class TrackerDrift(PlantEffect):
    """The tracker drifts in its own frame as it warms up, so that points at rest appear to move the opposite way.

    A published warm-up error is tenths of a millimetre within two hours; 10 to 40 um remain afterwards (an estimate).
    """

    twist: Array
    course: DriftCourse

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        return transform_points(self._motion(situation), p_M)

    def apparent_rotation(self, R_M_S: Array, situation: Situation) -> Array:
        return np.asarray(self._motion(situation)[:, :3, :3] @ R_M_S)

    def _motion(self, situation: Situation) -> Array:
        return rigid(_scaled(-self.course.share(situation.time_s), self.twist))


def _seat_slips(situation: Situation, shift: Array, slip: Slip) -> Deflection:
    """The SMR's seat slips on the flange. Sizes: 20 to 200 um (an estimate)."""
    slipped = slip.share(situation.time_s)[:, None] * shift
    return Deflection(tool=np.concatenate([slipped, np.zeros_like(slipped)], axis=1))


def _course(parameters: Parameters) -> tuple[Array, DriftCourse]:
    law = parameters.choice("law", *_LAWS)
    extra = {"sinusoidal": ("phase",), "wandering": ("seed",)}.get(law, ())
    parameters.require("shift", "turn", "law", "time", *extra)
    twist, time = np.append(parameters.numbers("shift", 3), parameters.numbers("turn", 3)), POSITIVE(parameters, "time")
    if law == "wandering":
        return twist, DriftCourse(law, time, paths=RandomPaths.sampled(parameters.integer("seed", least=0), 6, time))
    return twist, DriftCourse(law, time, parameters.number("phase", default=0.0))


def base_drift(parameters: Parameters) -> PlantEffect:
    """Build base drift: ``shift`` (3) [m], ``turn`` (3) [rad] in B; ``law`` and its ``time`` [s].

    ``law`` is linear, exponential, creep, sinusoidal (with ``phase`` [rad]) or wandering (with ``seed``).
    """
    return Offset(_base_moves, dict(zip(("twist", "course"), _course(parameters), strict=True)))


def tracker_drift(parameters: Parameters) -> PlantEffect:
    """Build tracker drift; parameters as of ``base_drift``, in M."""
    return TrackerDrift(*_course(parameters))


def _slips(effect: Callable[..., PlantEffect], **sizes: Read) -> Factory:
    """Return the factory of a slip. With ``law`` creeping, the share ``creeping`` follows with ``time_constant``."""
    creeping = made(effect, **sizes, time=NUMBER, creeping=NOT_NEGATIVE, time_constant=POSITIVE)
    return by_law(sudden=made(effect, **sizes, time=NUMBER), creeping=creeping)


base_step = _slips(
    lambda shift, turn, **slip: Offset(_base_moves, {"twist": np.append(shift, turn), "course": Slip(**slip)}),
    shift=VECTOR,
    turn=VECTOR,
)
"""``shift`` (3) [m] and ``turn`` (3) [rad] in B at ``time`` [s]; or ``law`` creeping."""

target_slip = _slips(lambda shift, **slip: Offset(_seat_slips, {"shift": shift, "slip": Slip(**slip)}), shift=VECTOR)
"""``shift`` (3) in the flange frame [m] at ``time`` [s]; ``law`` as of ``base_step``."""
