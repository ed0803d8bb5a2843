"""What a hidden effect of the simulated cell is, and how its parameters are read.

An effect says how the arm departs from the ideal one in a given situation, without loads (``offset``) and under the
loads of a posture (``bend``), what it remembers of motions and temperatures (``begin``, ``moved``, ``warmed``, or all
at once ``remembered``), and what the tracker sees of the SMR (``seen``). It overrides what it needs. The cell adds up
all effects and repeats ``bend`` until the loads of the deflected posture cause just that deflection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from drivers.plant.config import Array
from drivers.plant.mechanism import NO_DEFLECTION, Deflection, Load, Mechanism, Posture


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
    T_B_others : mapping
        Name of each other arm -> what takes coordinates of its base frame into those of this arm's, (4, 4).
    mechanism : Mechanism
        The true, undeflected arm.
    load : Load or None
        What the flange carries; None is the mechanism's payload.
    """

    q: Array
    approach: Array
    last_step: Array
    since_rest_s: Array
    time_s: Array
    air_c: Array
    joints_c: Array
    others: Mapping[str, Posture]
    T_B_others: Mapping[str, Array]
    mechanism: Mechanism
    load: Load | None = None


class Effect:
    """An effect that does nothing: the base of all others."""

    def begin(self, q: Array) -> Array | None:
        """What is remembered of an arm that has stood at ``q`` (1, N) for ever; None for an effect without memory."""
        return None

    def moved(self, memory: Array | None, q: Array) -> Array | None:
        """Memory after each joint went straight to ``q`` (1, N)."""
        return memory

    def warmed(self, memory: Array | None, air_c: float, joints_c: Array, duration_s: float) -> Array | None:
        """Memory after a time at the air temperature ``air_c`` and the joint temperatures ``joints_c`` (N,)."""
        return memory

    def remembered(self, situation: Situation) -> Array | None:
        """Memory (n, ...) of arms of which no more is known than the situation tells.

        A joint whose last step is zero came from afar in the direction of its approach; one that has none stands in the
        middle of any play. The n situations are one history where their times differ.
        """
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

    def only(self, *keys: str, optional: tuple[str, ...] = ()) -> None:
        """Demand these keys; allow the ``optional`` ones too and no other."""
        named = ", ".join((*keys, *(f"{key} (optional)" for key in optional)))
        for key in self._values:
            if key not in keys and key not in optional:
                raise ValueError(f"{self._where}: there is no parameter '{key}'; its parameters are {named}")
        for key in keys:
            if key not in self._values:
                raise ValueError(f"{self._where}: parameter '{key}' is missing; its parameters are {named}")

    def together(self, *keys: str) -> bool:
        """Whether these optional keys are there; it must be all or none."""
        there = [key for key in keys if key in self._values]
        if there and len(there) < len(keys):
            raise ValueError(f"{self._where}: {', '.join(keys)} belong together, but only {', '.join(there)} is given")
        return bool(there)

    def error(self, key: str, what: str) -> ValueError:
        """An error about one parameter, to be raised."""
        return ValueError(f"{self._where}: {key} {what}")

    def unfit(self, what: str) -> ValueError:
        """An error about the effect on this arm, to be raised."""
        return ValueError(f"{self._where}: {what}")

    def _list(self, key: str, count: int | None) -> list[Any]:
        count = self.joints if count is None else count
        value = self._values[key]
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if not isinstance(value, list | tuple) or len(value) != count:
            raise self.error(key, f"must be a list of {count} numbers, not {value!r}")
        return list(value)

    def _number(self, key: str, value: Any, what: str, above: float, least: float) -> float:
        if isinstance(value, bool) or not isinstance(value, Real) or not np.isfinite(float(value)):
            raise self.error(key, f"must {what} in SI units, not {value!r}")
        if float(value) <= above:
            raise self.error(key, f"must be greater than {above:g}, not {float(value):g}")
        if float(value) < least:
            raise self.error(key, f"must be at least {least:g}, not {float(value):g}")
        return float(value)

    def numbers(self, key: str, count: int | None = None, *, above: float = -np.inf, least: float = -np.inf) -> Array:
        """A list of ``count`` numbers (default: one a joint), each above ``above`` and at least ``least``."""
        return np.array([self._number(key, value, "hold numbers", above, least) for value in self._list(key, count)])

    def stiffnesses(self, key: str, count: int | None = None) -> Array:
        """A list of ``count`` stiffnesses, each above 0; ``inf`` is what does not yield."""
        values = self._list(key, count)
        return np.array([v if v == np.inf else self._number(key, v, "hold numbers", 0.0, 0.0) for v in values])

    def number(
        self, key: str, *, above: float = -np.inf, least: float = -np.inf, default: float | None = None
    ) -> float:
        """One number, above ``above`` and at least ``least``; ``default`` where the key is missing."""
        if default is not None and key not in self._values:
            return default
        return self._number(key, self._values[key], "be a number", above, least)

    def stiffness(self, key: str) -> float:
        """One stiffness, above 0; ``inf`` is what does not yield."""
        value = self._values[key]
        return float(np.inf) if value == np.inf else self._number(key, value, "be a number", 0.0, 0.0)

    def whole(self, key: str, *, least: int) -> int:
        """One whole number, at least ``least``."""
        value = self._values[key]
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise self.error(key, f"must be a whole number from {least} up, not {value!r}")
        return value

    def choice(self, key: str, *words: str) -> str:
        """One of some words."""
        value = self._values.get(key)
        if value not in words:
            raise self.error(key, f"must be one of {', '.join(words)}, not {value!r}")
        return str(value)

    def joint_numbers(self, key: str) -> np.ndarray:
        """A list of different joint numbers, counted from 1; returned counted from 0."""
        value = self._values[key]
        valid = isinstance(value, list | tuple) and len(set(value)) == len(value) > 0
        if not valid or any(isinstance(v, bool) or not isinstance(v, int) or not 1 <= v <= self.joints for v in value):
            raise self.error(key, f"must be a list of different joint numbers from 1 to {self.joints}, not {value!r}")
        return np.array(value, dtype=int) - 1
