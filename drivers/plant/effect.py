"""What a hidden effect of the simulated cell is, and how its parameters are read.

An effect says how the arm departs from the ideal one in a given situation, without loads (``offset``) and under the
loads of a posture (``bend``), what it remembers of the motions made (``begin``, ``moved``, ``approached``), and what
the tracker sees of the SMR (``seen``). It overrides what it needs. The cell adds up all effects and repeats ``bend``
until the loads of the deflected posture cause just that deflection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from drivers.plant.config import Array
from drivers.plant.mechanism import NO_DEFLECTION, Deflection, Posture


@dataclass(frozen=True, eq=False)
class Situation:
    """n situations of one arm, as far as an effect may know them.

    Attributes
    ----------
    q : array, shape (n, N)
        Drive-side joint angles: what the controller reports [rad].
    approach : array, shape (n, N)
        Sign of each joint's last motion; 0 where it has not moved.
    last_step : array, shape (n, N)
        The last motion [rad].
    since_rest_s : array, shape (n,)
        Time at rest [s]; zero while moving.
    time_s : array, shape (n,)
        The cell's clock [s].
    air_c : array, shape (n,)
        Air temperature [degC].
    joints_c : array, shape (n, N)
        Joint temperatures [degC].
    others : mapping
        Name of each other arm -> its undeflected posture at the same moment, in that arm's own base frame.
    """

    q: Array
    approach: Array
    last_step: Array
    since_rest_s: Array
    time_s: Array
    air_c: Array
    joints_c: Array
    others: Mapping[str, Posture]


class Effect:
    """An effect that does nothing: the base of all others."""

    def begin(self, q: Array) -> Array | None:
        """What is remembered of an arm that has stood at ``q`` (1, N) for ever; None for an effect without memory."""
        return None

    def moved(self, memory: Array | None, q: Array) -> Array | None:
        """Memory after each joint went straight to ``q`` (1, N)."""
        return memory

    def approached(self, q: Array, approach: Array) -> Array | None:
        """Memory (n, ...) of arms that came from afar to ``q`` (n, N) in the directions ``approach`` (n, N), or 0."""
        return None

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        """Departure from the ideal arm that no load causes."""
        return NO_DEFLECTION

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        """Departure from the ideal arm that the loads of ``posture`` cause."""
        return NO_DEFLECTION

    def seen(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        """Where the tracker sees (n, 3) an SMR that is at ``p_M`` and looks along ``normal_M`` (n, 3)."""
        return p_M


class Parameters:
    """The parameters of one effect as configured; a wrong one is a ``ValueError`` with where and what is expected."""

    def __init__(self, arm: str, effect: str, values: Mapping[str, Any], joints: int) -> None:
        self._where = f"arm {arm}, effect {effect}"
        self._values = values
        self.joints = joints

    def only(self, *keys: str) -> None:
        """Demand exactly these keys."""
        for key in self._values:
            if key not in keys:
                raise ValueError(f"{self._where}: there is no parameter '{key}'; its parameters are {', '.join(keys)}")
        for key in keys:
            if key not in self._values:
                raise ValueError(f"{self._where}: parameter '{key}' is missing; its parameters are {', '.join(keys)}")

    def error(self, key: str, what: str) -> ValueError:
        """An error about one parameter, to be raised."""
        return ValueError(f"{self._where}: {key} {what}")

    def numbers(self, key: str, count: int | None = None, *, above: float = -np.inf, least: float = -np.inf) -> Array:
        """A list of ``count`` numbers (default: one a joint), each above ``above`` and at least ``least``."""
        count = self.joints if count is None else count
        value = self._values[key]
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if not isinstance(value, list | tuple) or len(value) != count:
            raise self.error(key, f"must be a list of {count} numbers, not {value!r}")
        for number in value:
            if isinstance(number, bool) or not isinstance(number, Real) or np.isnan(float(number)):
                raise self.error(key, f"must hold numbers in SI units, not {number!r}")
            if float(number) <= above:
                raise self.error(key, f"must be greater than {above:g}, not {float(number):g}")
            if float(number) < least:
                raise self.error(key, f"must be at least {least:g}, not {float(number):g}")
        return np.array(value, dtype=np.float64)

    def joint_numbers(self, key: str) -> np.ndarray:
        """A list of different joint numbers, counted from 1; returned counted from 0."""
        value = self._values[key]
        valid = isinstance(value, list | tuple) and len(set(value)) == len(value) > 0
        if not valid or any(isinstance(v, bool) or not isinstance(v, int) or not 1 <= v <= self.joints for v in value):
            raise self.error(key, f"must be a list of different joint numbers from 1 to {self.joints}, not {value!r}")
        return np.array(value, dtype=int) - 1
