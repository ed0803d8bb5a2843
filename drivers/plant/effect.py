"""Base class of the hidden effects of the simulated cell, and the reader of their parameters.

An effect returns the deviation from the ideal arm in a situation: ``offset`` without loads, ``bend`` under the loads of
a posture. Effects with hysteresis or lag keep a memory of motions and temperatures (``initial_memory``,
``memory_after_motion``, ``memory_after_time``, or ``assumed_memory`` for arms without a known history). ``response`` is
the deviation caused by the course of a motion. ``apparent_position`` changes what the tracker measures. An effect
overrides what it needs. The cell adds up all effects and iterates ``bend`` until the loads of the deflected posture
cause exactly that deflection.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import Any

import numpy as np

from drivers.plant.config import Array
from drivers.plant.mechanism import NO_DEFLECTION, Deflection, Load, Mechanism, Posture


@dataclass(frozen=True, eq=False)
class Situation:
    """n situations of one arm: the inputs of an effect.

    Attributes
    ----------
    q : array, shape (n, N)
        Drive-side joint angles, as the controller reports them [rad].
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
        Name of each other arm -> its undeflected posture at the same time, in its own base frame.
    T_B_others : mapping
        Name of each other arm -> transform from its base frame to this arm's, (4, 4).
    mechanism : Mechanism
        The true, undeflected arm.
    load : Load or None
        Load on the flange; None: the mechanism's payload.
    inertia : array, shape (n, N), or None
        Torques of inertia about the axes [Nm]; None: at rest.
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
    inertia: Array | None = None


class PlantEffect:
    """Base class of all effects, without any influence."""

    def initial_memory(self, q: Array) -> Array | None:
        """Return the memory of an arm that has always rested at ``q`` (1, N); None for an effect without memory."""
        return None

    def memory_after_motion(self, memory: Array | None, q: Array) -> Array | None:
        """Return the memory after a motion without reversal of each joint to ``q`` (1, N)."""
        return memory

    def memory_after_time(self, memory: Array | None, air_c: float, joints_c: Array, duration_s: float) -> Array | None:
        """Return the memory after ``duration_s`` at these temperatures of the air and the joints (N,) [degC]."""
        return memory

    def assumed_memory(self, situation: Situation) -> Array | None:
        """Return the memory (n, ...) that follows from the situation alone.

        A joint whose last step is zero is assumed to have made a long motion in the direction of its approach; one
        without approach is in the middle of any play. Situations at different times are one history.
        """
        return None

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        """Return the deviation from the ideal arm that does not depend on loads."""
        return NO_DEFLECTION

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        """Return the deviation from the ideal arm that the loads of ``posture`` cause."""
        return NO_DEFLECTION

    def response(self, time_s: Array, q: Array, mechanism: Mechanism) -> Array | None:
        """Return the joint deviation (n, N) that depends on the whole course of a motion ``q`` (n, N) from rest at
        evenly spaced times (n,); zero at rest. None if there is none."""
        return None

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        """Return apparent positions (n, 3) of SMRs at ``p_M`` (n, 3) with viewing directions ``normal_M`` (n, 3)."""
        return p_M

    def apparent_rotation(self, R_M_S: Array, situation: Situation) -> Array:
        """Return apparent orientations (n, 3, 3) of 6-D probes."""
        return R_M_S


@dataclass(frozen=True, eq=False)
class Offset(PlantEffect):
    """An effect without loads and memory: ``law`` gives the deviation in a situation, for the ``values`` of it."""

    law: Callable[..., Deflection]
    values: Mapping[str, Any]

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return self.law(situation, **self.values)


@dataclass(frozen=True, eq=False)
class Bend(PlantEffect):
    """An effect of loads: ``law`` gives the deviation in a posture, for the ``values`` of it."""

    law: Callable[..., Deflection]
    values: Mapping[str, Any]

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return self.law(posture, **self.values)


@dataclass(frozen=True, eq=False)
class Apparent(PlantEffect):
    """An error of measured positions: ``law`` gives the apparent ones, for the ``values`` of it."""

    law: Callable[..., Array]
    values: Mapping[str, Any]

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        return self.law(p_M, normal_M, situation, **self.values)


def by(
    kind: Callable[[Callable[..., Any], Mapping[str, Any]], PlantEffect], law: Callable[..., Any]
) -> Callable[..., PlantEffect]:
    """Return what makes an effect of a ``kind`` from the values of its law."""
    return lambda **values: kind(law, values)


class Parameters:
    """Configured parameters of one effect. An invalid one raises ``ValueError`` with its place and what is expected."""

    def __init__(self, arm: str, effect: str, values: Mapping[str, Any], joints: int) -> None:
        self._arm, self._effect = arm, effect
        self._where = f"arm {arm}, effect {effect}"
        self._values = values
        self.joints = joints

    def require(self, *keys: str, optional: tuple[str, ...] = ()) -> None:
        """Require ``keys``, allow ``optional`` keys, refuse others."""
        named = ", ".join((*keys, *(f"{key} (optional)" for key in optional)))
        for key in self._values:
            if key not in keys and key not in optional:
                raise ValueError(f"{self._where}: unknown parameter '{key}'; its parameters are {named}")
        for key in keys:
            if key not in self._values:
                raise ValueError(f"{self._where}: parameter '{key}' is missing; its parameters are {named}")

    def by_law(self, default: str, *others: str) -> tuple[str, Parameters]:
        """Return the parameter ``law``, one of these words, ``default`` if it is missing; and the other parameters."""
        return self.choice("law", default, *others) if "law" in self._values else default, self.without("law")

    def without(self, left_out: str) -> Parameters:
        """Return the other parameters."""
        rest = {key: value for key, value in self._values.items() if key != left_out}
        return Parameters(self._arm, self._effect, rest, self.joints)

    def all_or_none(self, *keys: str) -> bool:
        """Return whether these optional keys are given; raise ``ValueError`` if only some of them are."""
        given = [key for key in keys if key in self._values]
        if given and len(given) < len(keys):
            raise ValueError(f"{self._where}: {', '.join(keys)} belong together, but only {', '.join(given)} is given")
        return bool(given)

    def error(self, key: str, what: str) -> ValueError:
        """Return an error about one parameter."""
        return ValueError(f"{self._where}: {key} {what}")

    def effect_error(self, what: str) -> ValueError:
        """Return an error about the effect on this arm."""
        return ValueError(f"{self._where}: {what}")

    def length(self, key: str) -> int:
        """Return the length of a list of numbers."""
        value = self._values[key]
        if not isinstance(value, list | tuple | np.ndarray) or not len(value):
            raise self.error(key, f"must be a list of numbers, not {value!r}")
        return len(value)

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
        """Return a list of ``count`` numbers (default: one per joint), each above ``above`` and at least ``least``."""
        return np.array([self._number(key, value, "hold numbers", above, least) for value in self._list(key, count)])

    def stiffnesses(self, key: str, count: int | None = None) -> Array:
        """Return a list of ``count`` stiffnesses, each above 0; ``inf`` is rigid."""
        values = self._list(key, count)
        return np.array([v if v == np.inf else self._number(key, v, "hold numbers", 0.0, 0.0) for v in values])

    def number(
        self, key: str, *, above: float = -np.inf, least: float = -np.inf, default: float | None = None
    ) -> float:
        """Return one number, above ``above`` and at least ``least``; ``default`` if the key is missing."""
        if default is not None and key not in self._values:
            return default
        return self._number(key, self._values[key], "be a number", above, least)

    def stiffness(self, key: str) -> float:
        """Return one stiffness, above 0; ``inf`` is rigid."""
        value = self._values[key]
        return float(np.inf) if value == np.inf else self._number(key, value, "be a number", 0.0, 0.0)

    def integer(self, key: str, *, least: int) -> int:
        """Return one whole number, at least ``least``."""
        value = self._values[key]
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise self.error(key, f"must be a whole number from {least} up, not {value!r}")
        return value

    def choice(self, key: str, *words: str) -> str:
        """Return one of the given words."""
        value = self._values.get(key)
        if value not in words:
            raise self.error(key, f"must be one of {', '.join(words)}, not {value!r}")
        return str(value)

    def joint_numbers(self, key: str) -> np.ndarray:
        """Return a list of different joint numbers; counted from 1 in the parameter, from 0 in the result.

        Lists that are read after it have one value for each of these joints.
        """
        value = self._values[key]
        valid = isinstance(value, list | tuple) and len(set(value)) == len(value) > 0
        if not valid or any(isinstance(v, bool) or not isinstance(v, int) or not 1 <= v <= self.joints for v in value):
            raise self.error(key, f"must be a list of different joint numbers from 1 to {self.joints}, not {value!r}")
        self.joints = len(value)
        return np.array(value, dtype=int) - 1


# -- Factories of effects, made from how each parameter is read --------------------------------------------------------


Factory = Callable[[Parameters], PlantEffect]
Read = Callable[[Parameters, str], Any]

NUMBER, NUMBERS, JOINTS = Parameters.number, Parameters.numbers, Parameters.joint_numbers
STIFFNESS, STIFFNESSES = Parameters.stiffness, Parameters.stiffnesses
POSITIVE, NOT_NEGATIVE = partial(NUMBER, above=0.0), partial(NUMBER, least=0.0)
POSITIVES, NOT_NEGATIVES = partial(NUMBERS, above=0.0), partial(NUMBERS, least=0.0)
VECTOR, SEED = partial(NUMBERS, count=3), partial(Parameters.integer, least=0)


def made(effect: Callable[..., PlantEffect], optional: Mapping[str, Read] | None = None, /, **reads: Read) -> Factory:
    """Return the factory of an effect that takes the parameters of these names, read in this order."""

    def factory(parameters: Parameters) -> PlantEffect:
        parameters.require(*reads, optional=tuple(optional or ()))
        return effect(**{key: read(parameters, key) for key, read in {**reads, **(optional or {})}.items()})

    return factory


def by_law(**factories: Factory) -> Factory:
    """Return the factory of an effect whose parameter ``law`` names one of these; the first if it is missing."""

    def factory(parameters: Parameters) -> PlantEffect:
        law, others = parameters.by_law(*factories)
        return factories[law](others)

    return factory


def of_arms(joints: int, what: str, factory: Factory) -> Factory:
    """Return a factory that refuses arms of fewer joints."""

    def checked(parameters: Parameters) -> PlantEffect:
        if parameters.joints < joints:
            raise parameters.effect_error(f"{what} needs an arm of at least {joints} joints, not {parameters.joints}")
        return factory(parameters)

    return checked


# -- Deviations of some joints of an arm ------------------------------------------------------------------------------


def on_joints(situation: Situation, joints: int | np.ndarray, angles: Array) -> Deflection:
    """Return the deviation by ``angles`` of one joint (n,) or of several (n, k) [rad]."""
    offsets = np.zeros_like(situation.q)
    offsets[:, joints] = angles
    return Deflection(joints=offsets)


def before_joints(situation: Situation, joints: np.ndarray, twists: Array) -> Deflection:
    """Return the deviation by twists (n, k, 6) of the axes of k joints, each in the frame before its joint."""
    n, count = situation.q.shape
    every = np.zeros((n, count + 1, 6))
    every[:, joints] = twists
    return Deflection(base=every[:, 0], links=every[:, 1:])


# -- First-order lags of joints along a path --------------------------------------------------------------------------


def lagging(q: Array, keep: Array) -> Array:
    """Return positions (n, N) on an even time grid behind first-order lags, each at rest before the first position;
    ``keep`` (N,) is the share of the distance that remains after one step."""
    from scipy.signal import lfilter  # it loads scipy.stats: only for cells that record motion

    lags = zip(q.T, keep.tolist(), strict=True)
    return np.column_stack([lfilter([1.0 - share], [1.0, -share], own, zi=share * own[:1])[0] for own, share in lags])
