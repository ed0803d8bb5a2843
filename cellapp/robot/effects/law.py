"""Laws of effects: their words, the constants they declare, and how the search tunes each constant."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import lru_cache
from typing import Protocol

import numpy as np

from cellapp.ground.counting import plain
from cellapp.robot.effects.context import EffectColumn, EffectContext
from cellapp.robot.kinematics.transforms import Array

AMPLITUDE_NAME = "amplitude"
"""Constant that only smooth forms have: the standard deviation of a free function."""


class InputVariable(Enum):
    """A quantity that effects depend on; effects that share one may be confounded."""

    JOINT_ANGLE = "q"
    TORQUE = "torque"
    PAYLOAD = "payload"
    APPROACH = "approach"
    STEP = "step"
    DWELL = "dwell"
    TIME = "time"
    AIR_TEMPERATURE = "air temperature"
    JOINT_TEMPERATURE = "joint temperature"
    OTHER_ARM = "other arm"
    BEAM = "beam"
    INCIDENCE = "incidence"
    SPEED = "speed"


class Tuning(Protocol):
    """Rule by which the search tunes a constant."""

    def nearby(self, value: float, context: EffectContext, shrink: float) -> list[float]:
        """Return values to try near ``value``; ``shrink`` (at most 1) reduces the step as the search converges."""


@dataclass(frozen=True)
class Fixed:
    """Not tuned: taken from the run, or set by the search itself."""

    def nearby(self, value: float, context: EffectContext, shrink: float) -> list[float]:
        """None."""
        return []


@dataclass(frozen=True)
class Scaled:
    """Multiplicative steps down and up, for constants of unknown scale; ``factor`` is the first step."""

    factor: float

    def nearby(self, value: float, context: EffectContext, shrink: float) -> list[float]:
        """One value below and one above."""
        step = math.log(self.factor) * shrink
        return [value * math.exp(-step), value * math.exp(step)]


@dataclass(frozen=True)
class NeighbouringPauses:
    """Steps of an onset to the ``reach`` pauses between readings before and after, ``margin`` from either end."""

    reach: int
    margin: int

    def nearby(self, value: float, context: EffectContext, shrink: float) -> list[float]:
        """Return the middles of the pauses [s]."""
        times = np.sort(np.asarray(context.conditions.time_s))
        pauses = (times[1:] + times[:-1]) / 2.0
        place = int(np.searchsorted(pauses, value))
        last = len(pauses) - self.margin
        around = range(max(place - self.reach, self.margin), min(place + self.reach + 1, last))
        return [float(pauses[i]) for i in around]


FIXED = Fixed()
SCALED = Scaled(math.exp(0.3))
"""Steps of 35 %: neighbours on the grids of the scan of laws differ by a factor of 1.5 to 2.5."""


@dataclass(frozen=True)
class Constant:
    """Declaration of a constant of a law: a number besides the fitted parameters.

    Attributes
    ----------
    name : str
        Key in ``Law.constants`` and in JSON; with the joint's number appended where ``per_joint``.
    unit : str
        SI; empty where dimensionless.
    tuning : Tuning
        Rule by which the search changes it.
    words : str
        For reports, with ``{}`` for the value: ``time constant {} min``, ``knee at {}``. Empty: not reported.
    each : str
        Value of one joint, ``{} Nm for joint {}``, where ``per_joint``.
    factor : float
        From SI to the unit in the words.
    per_joint : bool
        One value per joint.
    optional : bool
        Laws without it are valid.
    """

    name: str
    unit: str
    tuning: Tuning
    words: str = ""
    each: str = ""
    factor: float = 1.0
    per_joint: bool = False
    optional: bool = False

    def key(self, joint: int) -> str:
        """Key of one joint's value (joint from 0)."""
        return f"{self.name}{joint + 1}"

    def declares(self, key: str) -> bool:
        """Return whether ``key`` is one of its keys."""
        if not self.per_joint:
            return key == self.name
        return key.startswith(self.name) and key[len(self.name) :].isdigit()

    def describe(self, constants: Mapping[str, float], joints: Iterable[int] = ()) -> str:
        """Say its value in words, for joints counted from 0; empty if it has none or is not reported."""
        if not self.words:
            return ""
        if not self.per_joint:
            return self.words.format(self._shown(constants[self.name])) if self.name in constants else ""
        known = [(joint, constants[self.key(joint)]) for joint in joints if self.key(joint) in constants]
        values = ", ".join(self.each.format(self._shown(value), joint + 1) for joint, value in known)
        return self.words.format(values) if values else ""

    def _shown(self, value: float) -> str:
        return plain(value * self.factor)


@dataclass(frozen=True)
class LawForm:
    """A functional form that an effect may have.

    Attributes
    ----------
    name : str
        In JSON; empty where the effect has only one form.
    words : str
        A sentence fragment for reports.
    constants : tuple of Constant
        Every constant that a law of this form may carry.
    variables : frozenset of InputVariable
        Variables of this form; empty if they are all those of the effect.
    """

    name: str
    words: str
    constants: tuple[Constant, ...] = ()
    variables: frozenset[InputVariable] = frozenset()

    def law(self, constants: Mapping[str, float] | None = None, tried: int = 1) -> Law:
        """Return a law of this form with values for its constants."""
        return Law(self, {} if constants is None else constants, tried)

    @property
    def is_smooth(self) -> bool:
        """Whether its parameters are coefficients of smooth functions with priors of a fitted amplitude."""
        return any(one.name == AMPLITUDE_NAME for one in self.constants)

    def constant(self, key: str) -> Constant | None:
        """Return the declaration that ``key`` belongs to; None if there is none."""
        return next((one for one in self.constants if one.declares(key)), None)

    def undeclared(self, keys: Iterable[str]) -> list[str]:
        """Return the keys without a declaration."""
        return [key for key in keys if self.constant(key) is None]

    def missing(self, keys: Iterable[str]) -> list[str]:
        """Return the names of mandatory constants that are not among ``keys``."""
        given = set(keys)
        return [one.name for one in self.constants if not (one.per_joint or one.optional) and one.name not in given]


@dataclass(frozen=True)
class Law:
    """A form with values for its constants; its linear parameters are the columns of the effect.

    Attributes
    ----------
    form : LawForm
    constants : mapping
        Values in SI units, by the keys of the form's declarations.
    tried : int
        Number of alternatives it was chosen from (onsets, time constants): the choice costs 2 ln(tried) of its score.

    Raises
    ------
    ValueError
        If a constant is not declared by the form: it would never be tuned or reported.
    """

    form: LawForm
    constants: Mapping[str, float] = field(default_factory=dict)
    tried: int = 1

    def __post_init__(self) -> None:
        undeclared = self.form.undeclared(self.constants)
        if undeclared:
            raise ValueError(f"law '{self.name}' declares no constant '{undeclared[0]}'")

    @property
    def name(self) -> str:
        """The form's name."""
        return self.form.name

    def nearby(self, context: EffectContext, shrink: float) -> list[Law]:
        """Return laws with one constant changed by a step, by the tuning that the constant declares."""
        found = []
        for key, value in self.constants.items():
            constant = self.form.constant(key)
            assert constant is not None
            for trial in constant.tuning.nearby(value, context, shrink):
                found.append(replace(self, constants={**self.constants, key: trial}))
        return found

    def words(self, joints: Sequence[int] = ()) -> str:
        """Say the law in words, with its reported constants; of per-joint constants those of ``joints`` (from 0)."""
        whole = [one.describe(self.constants) for one in self.form.constants if not one.per_joint]
        by_joint = [one.describe(self.constants, joints) for one in self.form.constants if one.per_joint]
        return "; ".join(filter(None, [", ".join(filter(None, [self.form.words, *whole])), *by_joint]))


# -- Smooth free functions of one variable: the spectrum of their prior, and the constants that their laws share ------
#
# A smooth law ``sum_k b_k f_k(z)``, ``b_k ~ N(0, a^2 w_k)``, is a Gaussian process of its variable z with standard
# deviation a. On the circle the ``f_k`` are cosines and sines of k z with
#
#     w_k proportional to (5 / l^2 + k^2)^-3,   sum over k = 1
#
# the spectrum of a Matern-5/2 covariance of length scale l (Rasmussen, Williams, Gaussian Processes for Machine
# Learning, 2006, section 4.2). Amplitude and length are constants of the law: the search finds them by their evidence.


AMPLITUDE = Constant(AMPLITUDE_NAME, "", FIXED)
"""Standard deviation of the free function, in the unit of its parameters."""
LENGTH = Constant("length", "rad", FIXED)
"""Length scale of a function of a joint angle."""
CYCLES = Constant("cycles", "", FIXED)
"""Highest cycle count of a function of a joint angle."""
_SPECTRUM_CYCLES = 4000
"""Cycle counts over which the spectrum is normalised. At a length scale of 1.5 degrees less than 1e-8 is beyond."""


@dataclass(frozen=True)
class LengthRange:
    """First guess and bounds of a length scale [rad], of a field over the workspace [m]."""

    start: float
    least: float
    most: float


@dataclass(frozen=True)
class SmoothLaw:
    """A smooth law with one amplitude.

    ``form`` is the name of its form, ``start`` a first guess of its amplitude; ``lengths`` are given where one length
    scale is found as well.
    """

    form: str
    start: float
    constants: Mapping[str, float] = field(default_factory=dict)
    lengths: LengthRange | None = None


@lru_cache(maxsize=256)
def _spectrum(length: float) -> Array:
    k = np.arange(1.0, _SPECTRUM_CYCLES + 1.0)
    spectrum = (5.0 / length**2 + k**2) ** -3
    return np.asarray(spectrum / spectrum.sum())


def circle_variances(length: float, cycles: int) -> Array:
    """Relative prior variances (cycles,) of the cosine, and of the sine, of 1 ... ``cycles`` cycles per revolution."""
    return _spectrum(float(length))[:cycles]


def with_prior_sd(column: EffectColumn, sd: float) -> EffectColumn:
    """The column with a prior on its parameter."""
    return replace(column, prior_sd=sd)
