"""An effect from a plain function: the law of a user in a few lines, searched for and reported like all others.

The function takes readings and parameters by their names and returns what the effect moves, for all readings at once::

    @own_law("pull of the hose package", pull=Linear("rad/rad", most=1e-2), slack=Tuned("rad", 0.6, 1.0, 1.6))
    def hose_pull(q, pull, slack):
        return -pull * np.sign(q) * np.maximum(np.abs(q) - slack, 0.0)

``acts_on`` says what it returns: offsets of the joints (n, N) [rad], or a shift (n, 3) [m] of the SMR in the axes of
base, tool or tracker. Linear parameters of joints arrive as an array (N,), one value a joint, all others as numbers.
"""

from __future__ import annotations

import inspect
import itertools
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, joint_column, shift_column, varies
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import FIXED, SCALED, Constant, InputVariable, Law, LawForm, Tuning
from cellapp.robot.effects.time_functions import with_default
from cellapp.robot.kinematics.transforms import Array

LawActsOn = Literal["joints", "base", "tool", "tracker"]
LawFunction = Callable[..., Array]
"""Readings and parameters by name -> (n, N) [rad] or (n, 3) [m]."""

_NONLINEAR = 0.01
"""Share by which a law may deviate from a straight line in a linear parameter, within that parameter's bounds."""
_TRIED_ROWS, _TRIED_JOINTS = 12, 6
"""Size of the made-up readings on which a law is tried when it is declared."""


@dataclass(frozen=True)
class Linear:
    """A parameter that the law is linear in, and its physical bounds; ``least`` is ``-most`` unless given."""

    unit: str
    most: float
    least: float | None = None

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest value that are possible."""
        return (-self.most if self.least is None else self.least, self.most)


class Tuned:
    """A parameter that the law is not linear in: the search begins at each of ``starts`` and tunes the best.

    ``words`` is how reports say it, with ``{}`` for the value times ``factor``; the default is its name and unit.
    """

    def __init__(self, unit: str, *starts: float, words: str = "", factor: float = 1.0) -> None:
        if not starts:
            raise ValueError("a tuned parameter needs at least one value to begin with")
        self.unit, self.starts, self.words, self.factor = unit, starts, words, factor

    def constant(self, name: str) -> Constant:
        """Its declaration: tuned by factors if all starts are positive, else by steps of their smallest distance."""
        tuning: Tuning = SCALED
        if min(self.starts) <= 0.0:
            apart = np.diff(np.unique(self.starts))
            tuning = _Stepped(float(apart.min()) if len(apart) else 1.0)
        words = self.words or f"{name} {{}} {self.unit}".rstrip()
        return Constant(name, self.unit, tuning, words, factor=self.factor)


@dataclass(frozen=True)
class _Stepped:
    """Steps down and up, for constants that may be zero or negative; ``step`` is the first one."""

    step: float

    def nearby(self, value: float, context: EffectContext, shrink: float) -> list[float]:
        """One value below and one above."""
        return [value - self.step * shrink / 2.0, value + self.step * shrink / 2.0]


@dataclass(frozen=True)
class _Quantity:
    """What a law may take of the readings: its variable, and how its values (n, N), else (n,), are read.

    Where readings ``may_lack`` it, ``of`` gives None or NaN, for which its mean over the run stands.
    """

    variable: InputVariable
    of: Callable[[EffectContext], Array | None]
    per_joint: bool = False
    may_lack: bool = False


QUANTITIES: Mapping[str, _Quantity] = {
    "q": _Quantity(InputVariable.JOINT_ANGLE, lambda context: context.q, per_joint=True),
    "qd": _Quantity(InputVariable.SPEED, lambda context: None, per_joint=True),
    "qdd": _Quantity(InputVariable.SPEED, lambda context: None, per_joint=True),
    "tau": _Quantity(InputVariable.TORQUE, lambda context: context.torques, per_joint=True),
    "payload_kg": _Quantity(InputVariable.PAYLOAD, lambda context: context.payload_kg),
    "approach": _Quantity(InputVariable.APPROACH, lambda context: context.approach, per_joint=True),
    "step": _Quantity(InputVariable.STEP, lambda context: context.step, per_joint=True),
    "dwell_s": _Quantity(InputVariable.DWELL, lambda context: context.conditions.dwell_s, may_lack=True),
    "time_s": _Quantity(InputVariable.TIME, lambda context: context.conditions.time_s, may_lack=True),
    "air_c": _Quantity(InputVariable.AIR_TEMPERATURE, lambda context: context.conditions.air_c, may_lack=True),
    "joints_c": _Quantity(
        InputVariable.JOINT_TEMPERATURE, lambda context: context.conditions.joints_c, per_joint=True, may_lack=True
    ),
}
"""Names of arguments that a law may take: joint positions q (n, N) [rad], speeds qd [rad/s] and accelerations qdd
[rad/s^2] of recordings of motion (n, N), which readings at rest do not have, torques of gravity tau (n, N) [Nm], signs
and sizes of the last motions (n, N), payload, rest, time, air temperature (n,), temperatures of the joints (n, N)."""


_SPEEDS = frozenset({"qd", "qdd"})
_IN_MOTION = frozenset({"q", "qd", "qdd", "tau", "approach"})
"""What a law of speeds may take; tau is then that of gravity and inertia, approach the direction with history."""


def own_law(
    title: str,
    *,
    acts_on: LawActsOn = "joints",
    confounded: tuple[str, ...] = (),
    check: tuple[str, ...] = (),
    size: str = "not stated",
    **parameters: Linear | Tuned,
) -> Callable[[LawFunction], type[Effect]]:
    """Make an effect from the function below: its name is the slug, its docstring the cause in words.

    Every argument of the function is a name of ``QUANTITIES`` or one of ``parameters``.

    Raises
    ------
    ValueError
        From the decorated function's declaration: an unknown argument, a parameter that it does not take, a result of
        another shape, not zero without its parameters, or not linear in one that is declared so.
    """

    def made(function: LawFunction) -> type[Effect]:
        law = _Declared(function, acts_on, parameters)
        law.check()
        name = re.sub("(?:^|_)([a-z])", lambda found: found[1].upper(), law.slug)
        return type(name, (_OwnEffect,), law.declarations(title, confounded, check, size))

    return made


@dataclass(frozen=True)
class MotionLaw:
    """A law of speeds with values of its tuned parameters, for recordings of motion.

    Attributes
    ----------
    value : str
        Slug of the effect.
    constants : tuple
        Tuned parameter and its value.
    """

    value: str
    constants: tuple[tuple[str, float], ...]
    declared: _Declared = field(repr=False, compare=False)

    @property
    def needs_torques(self) -> bool:
        """Whether it depends on torques."""
        return "tau" in self.declared.taken

    @property
    def parameters(self) -> Mapping[str, Linear]:
        """Its linear parameters by name."""
        return self.declared.linear

    def offset(self, name: str, joint: int, quantity: Callable[[str], Array]) -> Array:
        """Offset (n,) [rad] of a joint (from 0) for one unit of a linear parameter; ``quantity`` gives those (n, N)."""
        own = self.declared
        taken = {word: quantity(word) for word in own.taken}
        joints = next(iter(taken.values())).shape[1]
        most = own.linear[name].most
        values = {other: np.zeros(joints) for other in own.linear} | {name: most * np.eye(joints)[joint]}
        return np.asarray(own.moved(taken, dict(self.constants), values)[:, joint] / most)


def motion_laws(effects: Iterable[Effect]) -> list[MotionLaw]:
    """The laws of speeds among some effects: one for each combination of values that tuned parameters begin with."""
    return [
        MotionLaw(own.slug, tuple(zip(own.tuned, starts, strict=True)), own)
        for own in (effect.declared for effect in effects if isinstance(effect, _OwnEffect))
        if own.is_of_speeds
        for starts in itertools.product(*(one.starts for one in own.tuned.values()))
    ]


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Declared:
    """A user's function with its parameters."""

    function: LawFunction
    acts_on: LawActsOn
    parameters: Mapping[str, Linear | Tuned]

    @property
    def slug(self) -> str:
        return self.function.__name__

    @property
    def linear(self) -> dict[str, Linear]:
        return {name: one for name, one in self.parameters.items() if isinstance(one, Linear)}

    @property
    def tuned(self) -> dict[str, Tuned]:
        return {name: one for name, one in self.parameters.items() if isinstance(one, Tuned)}

    @property
    def taken(self) -> list[str]:
        """Names of the quantities of readings that it takes."""
        return [name for name in inspect.signature(self.function).parameters if name in QUANTITIES]

    @property
    def is_of_speeds(self) -> bool:
        """Whether it shows in recordings of motion alone."""
        return bool(_SPEEDS & set(self.taken))

    def declarations(
        self, title: str, confounded: tuple[str, ...], check: tuple[str, ...], size: str
    ) -> dict[str, Any]:
        """Attributes of the effect's class."""
        said = " ".join((inspect.getdoc(self.function) or f"{title} at {{place}}").split())
        constants = [one.constant(name) for name, one in self.tuned.items()]
        constants += [
            Constant(_typical(name), "", FIXED, per_joint=QUANTITIES[name].per_joint)
            for name in self.taken
            if QUANTITIES[name].may_lack
        ]
        return {
            "__doc__": said,
            "__module__": self.function.__module__,
            "slug": self.slug,
            "title": title,
            "meaning": Meaning(said, size, "estimate", check, ()),
            "confounded": confounded,
            "variables": frozenset(QUANTITIES[name].variable for name in self.taken),
            "forms": (LawForm("own", f"as the law {self.slug} says", tuple(constants)),),
            "declared": self,
        }

    def moved(self, readings: Mapping[str, Array], constants: Mapping[str, float], linear: Mapping[str, Any]) -> Array:
        """What the function returns for readings, tuned constants and linear parameters."""
        return np.asarray(self.function(**readings, **constants, **linear), dtype=np.float64)

    def units(self, joints: int) -> list[tuple[str, int | None, dict[str, Any]]]:
        """Every linear parameter with its largest value and the others zero: name, joint from 0 or None, values."""
        zero = {name: np.zeros(joints) if self.acts_on == "joints" else 0.0 for name in self.linear}
        if self.acts_on != "joints":
            return [(name, None, {**zero, name: one.most}) for name, one in self.linear.items()]
        eye = np.eye(joints)
        return [
            (name, j, {**zero, name: one.most * eye[j]}) for j in range(joints) for name, one in self.linear.items()
        ]

    def check(self) -> None:
        """Try it on made-up readings. Raises ``ValueError`` as ``own_law`` says."""
        arguments = list(inspect.signature(self.function).parameters)
        for name in arguments:
            if name not in QUANTITIES and name not in self.parameters:
                known = ", ".join(QUANTITIES)
                raise ValueError(
                    f"law {self.slug}: argument '{name}' is no quantity of readings ({known}) and not declared;"
                    f" write {name}=Linear(unit, most) or {name}=Tuned(unit, start) into the line above it"
                )
        missing = [name for name in self.parameters if name not in arguments or name in QUANTITIES]
        if missing or not self.linear or not self.taken:
            lacks = f"parameter '{missing[0]}'" if missing else "a Linear parameter" if self.taken else "a quantity"
            raise ValueError(f"law {self.slug}: the function does not take {lacks}")
        if self.is_of_speeds and (self.acts_on != "joints" or not set(self.taken) <= _IN_MOTION):
            raise ValueError(
                f"law {self.slug}: a law of speeds acts on joints and takes no other quantities than"
                f" {', '.join(sorted(_IN_MOTION))}"
            )
        self._check_linear()

    def _check_linear(self) -> None:
        """Zero without its parameters, of the right shape, and linear in each of them."""
        rng = np.random.default_rng(1)
        n, joints = _TRIED_ROWS, _TRIED_JOINTS
        made_up = {
            name: rng.uniform(-3.0, 3.0, (n, joints) if QUANTITIES[name].per_joint else n) for name in self.taken
        }
        constants = {name: one.starts[0] for name, one in self.tuned.items()}
        expected = (n, joints) if self.acts_on == "joints" else (n, 3)
        for name, _, values in self.units(joints):
            whole = self.moved(made_up, constants, values)
            if whole.shape != expected:
                raise ValueError(
                    f"law {self.slug}: returns shape {whole.shape}, expected {expected} for {self.acts_on}"
                )
            half = self.moved(made_up, constants, {key: value / 2.0 for key, value in values.items()})
            nothing = self.moved(made_up, constants, {key: value * 0.0 for key, value in values.items()})
            if nothing.any():
                raise ValueError(f"law {self.slug}: it moves something where all its linear parameters are zero")
            if np.abs(whole - 2.0 * half).max() > _NONLINEAR * np.abs(whole).max():
                raise ValueError(
                    f"law {self.slug}: it is not linear in '{name}'; declare that as Tuned, with values to begin with"
                )

    def readings(self, context: EffectContext, law: Law) -> dict[str, Array]:
        """The quantities that it takes; typical values of the run where unknown."""
        found = {}
        for name in self.taken:
            values = QUANTITIES[name].of(context)
            if QUANTITIES[name].may_lack or values is None:
                values = with_default(values, _mean_over_run(name, law, context.joints), len(context))
            found[name] = values
        return found


class _OwnEffect(Effect):
    """An effect whose columns come from a user's function."""

    declared: _Declared

    def missing_data(self, context: EffectContext) -> str:
        """Needs every quantity that the law takes, varying over the run."""
        if self.declared.is_of_speeds:
            return "readings at rest have no speeds; record motion"
        for name in self.declared.taken:
            if not varies(QUANTITIES[name].of(context)):
                return f"{name} is not in the readings, or does not vary"
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each combination of values to begin with."""
        own = self.declared
        typical: dict[str, float] = {}
        for name in own.taken:
            quantity = QUANTITIES[name]
            values = quantity.of(context) if quantity.may_lack else None
            if values is None:
                continue
            if quantity.per_joint:
                typical |= {f"{_typical(name)}{j + 1}": float(np.nanmean(row)) for j, row in enumerate(values.T)}
            else:
                typical[_typical(name)] = float(np.nanmean(values))
        tried = math.prod(len(one.starts) for one in own.tuned.values())
        combined = itertools.product(*(one.starts for one in own.tuned.values()))
        return [self.forms[0].law({**typical, **dict(zip(own.tuned, one, strict=True))}, tried) for one in combined]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column for each linear parameter, of joints one a joint: what it moves for one unit."""
        own = self.declared
        readings = own.readings(context, law)
        constants = {name: law.constants[name] for name in own.tuned}
        columns = []
        for name, joint, values in own.units(context.joints):
            kind = own.linear[name]
            moved = own.moved(readings, constants, values) / kind.most
            if joint is not None:
                columns.append(joint_column(f"{name}{joint + 1}", kind.unit, joint, moved[:, joint], *kind.bounds))
            else:
                acts_on = ActsOn(own.acts_on)
                columns.append(
                    shift_column(name, kind.unit, acts_on, _in_tracker(context, acts_on, moved), *kind.bounds)
                )
        return columns


def _typical(name: str) -> str:
    """Key of the constant that holds a quantity's mean over the run."""
    return f"typical_{name}"


def _mean_over_run(name: str, law: Law, joints: int) -> float | Array:
    """A quantity's mean over the run, as the law's constants have it; one a joint (N,) of quantities of joints."""
    typical = _typical(name)
    if QUANTITIES[name].per_joint:
        return np.array([law.constants[f"{typical}{j + 1}"] for j in range(joints)])
    return law.constants[typical]


def _in_tracker(context: EffectContext, acts_on: ActsOn, shift: Array) -> Array:
    """A shift (n, 3) [m] in the axes of base, tool or tracker, in the tracker's axes."""
    if acts_on is ActsOn.TRACKER:
        return context.moved(shift)
    return context.twist_shift(0 if acts_on is ActsOn.BASE else context.joints, shift, None)
