"""Effects without a name: a data-driven term that states which place depends on which one or two variables."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations, product
from typing import ClassVar

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, joint_column, shift_column
from cellapp.robot.effects.data_driven import (
    FIELD_LENGTH,
    FIRST_CONSTANTS,
    PERIOD,
    POSITION,
    SECOND_CONSTANTS,
    ActedOn,
    DataDrivenForm,
    Direction,
    Quantity,
    Variable,
    acted_on,
    data_driven_form,
    field_frequencies,
    field_functions,
    field_variances,
    form_named,
    form_of,
    position_in_base,
    variables,
)
from cellapp.robot.effects.effect import (
    BorrowedForm,
    Effect,
    Meaning,
    borrowed,
    borrowed_form_named,
    contradiction_meaning,
    enumeration,
    is_contradiction,
    lent_effect,
    lent_law,
)
from cellapp.robot.effects.law import AMPLITUDE, Constant, InputVariable, Law, LawForm, SmoothLaw, with_prior_sd
from cellapp.robot.effects.time_functions import run_span, with_default
from cellapp.robot.kinematics.transforms import Array

# -- What a data-driven term means for people: checks by what it moves, further stops by what it depends on -----------


_OTHER_STATION = "Measure some of the stops from a second tracker station: a field of the tracker moves with it."
UNKNOWN_MEANING = Meaning(
    cause=(
        "Something moves {place} by a law that the library does not have; where it follows the position alone, it is a"
        " field of the workspace or of the tracker's volume."
    ),
    size="No size is known in advance: the report states what was found",
    size_source="none",
    check=(
        "Look at the figure of the term: a jump, a bend or a period often tells where it comes from.",
        "Check what was changed in the cell since the last good run: cables, hoses, tool, mounts, software.",
        "For a field: look for warm air across the beam, sunlight, a stand or floor that gives way.",
    ),
    settle=(
        _OTHER_STATION,
        "Repeat the run on another day: what belongs to the machine stays, what belongs to the day does not.",
    ),
)

_CHECKS: Mapping[ActsOn, tuple[str, ...]] = {
    ActsOn.JOINT: (
        "Check cables and hoses along {place}: a dress pack that pulls acts like this.",
        "Check gear, encoder and bolts of {place}.",
    ),
    ActsOn.BASE: (
        "Check the bolts of base plate, pedestal and anchors.",
        "Look for what else moves in the cell: the other arm, a conveyor, a door, traffic on the floor.",
    ),
    ActsOn.TOOL: (
        "Check the screws of the SMR's mount and of the tool, and the seat of the SMR on it.",
        "Check cables at the wrist that pull at the mount.",
    ),
    ActsOn.TRACKER: (
        "Check the tracker's stand, its weather station and its warm-up; run the two-face check.",
        "Look for warm air across the beam: heaters, open doors, the arm's own controller.",
    ),
}

_SETTLE: Mapping[Quantity, str] = {
    Quantity.JOINT_ANGLE: "Move {variable} alone through its range, forth and back, all other joints at rest.",
    Quantity.OTHER_JOINT_ANGLE: "Move {variable} at random between stops, then park it for 20 stops.",
    Quantity.TIME: "Measure a reference pose and fixed nests every 20 stops, over a whole run and on another day.",
    Quantity.TORQUE: "Repeat 20 stops with a second payload.",
    Quantity.STEP: "Approach one pose with last steps of 1, 5, 20 and 60 degrees of {variable}, from both sides.",
    Quantity.DWELL: "Vary the dwell from 0.5 to 10 s at random.",
    Quantity.PAYLOAD: "Measure the same 10 poses with three payloads.",
    Quantity.TEMPERATURE: "Log temperatures while the cell warms up and cools down; a reference pose every 20 stops.",
    Quantity.RANGE: "Measure some of the stops from a second tracker station, nearer and farther.",
    Quantity.AZIMUTH: "Measure some of the stops from a second tracker station.",
    Quantity.ELEVATION: "Measure some of the stops from a second tracker station, higher or lower.",
    Quantity.INCIDENCE: "Measure the same point at six rolls of the wrist.",
    **dict.fromkeys((Quantity.X, Quantity.Y, Quantity.Z), UNKNOWN_MEANING.settle[0]),
}


def data_driven_meaning(acts_on: ActedOn, inputs: Sequence[Variable]) -> Meaning:
    """Meaning of a term that moves ``acts_on`` with one or two variables."""
    settle = dict.fromkeys(_to_settle(one) for one in inputs)
    depends = enumeration([_variable_in_words(one) for one in inputs])
    return replace(
        UNKNOWN_MEANING,
        cause=f"Something moves {{place}} with {depends}, by a law that the library does not have.",
        check=(*_CHECKS.get(acts_on.acts_on, ()), *UNKNOWN_MEANING.check[:2]),
        settle=(*settle, UNKNOWN_MEANING.settle[-1]),
    )


def imitation_meaning(title: str, meaning: Meaning) -> Meaning:
    """Meaning of a term that moves a joint by its angle and looks like an effect, ``title``, that is less probable."""
    return replace(
        UNKNOWN_MEANING,
        cause=f"Something moves {{place}} and looks like {title}; a dress pack that pulls at it is more probable.",
        check=tuple(dict.fromkeys((*_CHECKS[ActsOn.JOINT], *meaning.check))),
        settle=("Take the hose or cable off {place} and measure 20 stops again.", *meaning.settle),
    )


def _to_settle(variable: Variable) -> str:
    return _SETTLE.get(variable.quantity, _OTHER_STATION).replace("{variable}", _variable_in_words(variable))


def _variable_in_words(variable: Variable) -> str:
    """``joint 2``, ``joint 3 of the other arm``, ``the torque on joint 2``, ``time``."""
    if variable.joint is None:
        return variable.quantity.words
    joint = f"joint {variable.joint + 1}"
    if variable.quantity is Quantity.OTHER_JOINT_ANGLE:
        return f"{joint} of the other arm"
    return joint if variable.quantity in (Quantity.JOINT_ANGLE, Quantity.STEP) else f"the torque on {joint}"


PAIRS = LawForm("pairs", "smoothly with neighbouring joints", (AMPLITUDE,))
"""Joints that depend on their neighbours' angles, and on both angles together: a part of the unnamed term."""
_PAIR_WAVES = ((0, 1), (0, 2), (1, 1), (1, 2), (2, 1), (2, 2))
"""Cycles per revolution of the joint that moves, and of its neighbour; its own angle alone has a curve."""
_BOUNDS = (-1e-2, 1e-2)
"""Bound of each parameter [rad, m]; nothing is known about the size of an unknown effect."""
_PERIODS = 48
"""Periods to try, 7 % apart over the range that a run of a few hundred stops resolves."""
_STOPS_PER_PERIOD = 12.0
"""Mean number of stops in the shortest period."""
_FEWEST = 24
"""Stops below which the shortest period is not shortened further."""


class Unknown(Effect):
    """A data-driven term ``sum_k b_k f_k(v)`` in one place, or ``sum_k b_k f_k(v, w)``; b in rad or m.

    Of a joint angle v: cosine and sine of v to 4 v. Of time: linear, and cosine of 1 to 20 half cycles over the run, or
    with ``period_s`` cosine and sine of one period. Of anything else: Legendre polynomials to order 4 on the range it
    had in the run, constant beyond it. Of two variables: all such functions of total order up to 3, of two angles also
    all products to order 3 each. Constants: ``order``, ``low``, ``high`` and ``typical`` (the default where unknown:
    the end of the run for time, no step, the run's median dwell, its mean temperature, the nominal payload), ``center``
    of an azimuth; with a ``2`` appended for the second variable.

    Of the position: the smooth field over the workspace of ``robot.effects.data_driven``, a shift along x, y and z of
    the base with one amplitude and one length scale. Of neighbouring joints: ``PAIRS``, with one amplitude.

    A law of the library whose values are impossible, or that imitates a part of something else, is one as well.

    It is not scanned like the named effects; ``dictionary`` and ``pairs`` list the laws to try. A term imitates every
    named effect that has its place and variable.
    """

    slug = "unknown"
    title = "unknown effect"
    meaning = UNKNOWN_MEANING
    variables: ClassVar[frozenset[InputVariable]] = frozenset()
    forms: ClassVar[tuple[LawForm, ...]] = (PAIRS,)

    def __init__(self, library: Mapping[str, Effect] | None = None) -> None:
        self._library = {} if library is None else library

    def form(self, name: str) -> LawForm:
        """The form of a name such as ``joint 2|q1`` or ``contradiction|backlash|constant``."""
        form = form_named(name) or borrowed_form_named(name, {**self._library, self.slug: self})
        return super().form(name) if form is None else form

    def laws(self, context: EffectContext) -> list[Law]:
        """None: they are not scanned."""
        return []

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Neighbouring joints, without a name."""
        return [SmoothLaw(borrowed("unnamed", self, PAIRS).name, 2e-5)]

    def meaning_of(self, law: Law) -> Meaning:
        """Checks by place and further stops by variables; those of the effect that a contradiction behaves like."""
        if is_contradiction(law):
            return contradiction_meaning(lent_effect(law))
        if isinstance(law.form, BorrowedForm):
            return imitation_meaning(law.form.effect.title, law.form.effect.meaning)
        if not isinstance(law.form, DataDrivenForm):
            return self.meaning
        return data_driven_meaning(law.form.acts_on, law.form.inputs)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per function and direction, all in one block; those of the effect for a law of the library."""
        if isinstance(law.form, BorrowedForm):
            of_effect = law.form.effect.columns(context, lent_law(law), names)
            return [replace(column, lower=-np.inf, upper=np.inf) for column in of_effect]
        if law.form == PAIRS:
            return _of_neighbours(context, law.constants[AMPLITUDE.name], names)
        acts_on = data_driven_form(law).acts_on
        if acts_on not in acted_on(context.joints):
            raise ValueError(f"effect {self.slug} has no law '{law.name}' for an arm with {context.joints} joints")
        values = functions(context, law)
        if acts_on.acts_on is ActsOn.JOINT:
            assert acts_on.joint is not None
            prefix = _label(acts_on)
            return [
                joint_column(f"{prefix}.{name}", "rad", acts_on.joint, one, *_BOUNDS, acts_on.name)
                for name, one in values.items()
            ]
        columns = [
            shift_column(f"{_label(part)}.{name}", unit, acts_on.acts_on, one[:, None] * moved, *_BOUNDS, acts_on.name)
            for part, (unit, moved) in zip(acts_on.parts, _shifts(context, acts_on), strict=True)
            for name, one in values.items()
        ]
        return _with_priors(columns, law) if data_driven_form(law).is_field else columns


@dataclass(frozen=True)
class FunctionFamily:
    """Functions of one or two variables that any place may depend on: the variables, and the constants of the law."""

    inputs: tuple[Variable, ...]
    constants: Mapping[str, float]

    def law(self, acts_on: ActedOn) -> Law:
        """The data-driven law of a place."""
        return form_of(acts_on, self.inputs).law(self.constants)


def curve_families(context: EffectContext) -> list[FunctionFamily]:
    """Functions of every variable that the data at hand allow, the straight lines first.

    Unlike a curve a line is not misled by a few stops far from the others.
    """
    constants = {one: run_constants(context, one) for one in variables(context)}
    straight = [
        FunctionFamily((one,), {**values, "order": 1.0})
        for one, values in constants.items()
        if not one.is_joint_angle and one.quantity is not Quantity.TIME and values["order"] > 1.0
    ]
    curves = [FunctionFamily((one,), values) for one, values in constants.items()]
    time = Variable(Quantity.TIME)
    periods = _single_periods(constants[time], len(context)) if time in constants else []
    return [*straight, *curves, *(FunctionFamily((time,), one) for one in periods)]


def pair_families(
    context: EffectContext, among: Collection[Variable] | None = None, orders: Sequence[int] = ()
) -> list[FunctionFamily]:
    """Functions of all pairs of variables that vary, or of those ``among`` them, of each total order.

    The default are ``PAIR_ORDERS``, for two angles ``ANGLE_PAIR_ORDERS``.
    """
    used = [one for one in variables(context) if among is None or one in among]
    constants = {one: run_constants(context, one) for one in used}
    found = []
    for first, second in combinations(used, 2):
        both = {**constants[first], **{f"{key}2": value for key, value in constants[second].items()}}
        angles = first.is_joint_angle and second.is_joint_angle
        for most in orders or (ANGLE_PAIR_ORDERS if angles else PAIR_ORDERS):
            limited = {key: float(most if angles else min(both[key], most)) for key in ("order", "order2")}
            found.append(FunctionFamily((first, second), {**both, **limited}))
    return found


def _single_periods(ends: Mapping[str, float], stops: int) -> list[dict[str, float]]:
    """Constants of laws with one period each, from twice the duration of the run to a dozen stops."""
    run_s = ends["high"] - ends["low"]
    shortest = _STOPS_PER_PERIOD * run_s / max(stops, _FEWEST)
    periods = np.geomspace(2.0 * run_s, shortest, _PERIODS).tolist()
    return [{**ends, "order": 1.0, PERIOD.name: period} for period in periods]


def own_angles(context: EffectContext) -> tuple[Variable, ...]:
    """The arm's own joint angles."""
    return tuple(Variable(Quantity.JOINT_ANGLE, joint) for joint in range(context.joints))


def _with_priors(columns: list[EffectColumn], law: Law) -> list[EffectColumn]:
    """The columns of a field with the priors of its amplitude and length scale; each direction has all functions."""
    variances = field_variances(law.constants[FIELD_LENGTH.name], field_frequencies(law.constants))
    sd = law.constants[AMPLITUDE.name] * np.sqrt(variances)
    return [with_prior_sd(column, sd[k % len(sd)]) for k, column in enumerate(columns)]


def acted_directions(context: EffectContext, acts_on: ActedOn) -> list[Array]:
    """SMR shifts (n, 3) [m, tracker frame] per unit of a place other than a joint, in each of its directions."""
    return [moved for _, moved in _shifts(context, acts_on)]


def _of_neighbours(context: EffectContext, amplitude: float, names: Collection[str] | None) -> list[EffectColumn]:
    """Products of waves of each joint's angle and a neighbour's, the smaller by prior the more cycles they have.

    For each joint and neighbour the prior variances add to the square of the amplitude [rad].
    """
    columns, total = [], math.sqrt(sum((2 if a else 1) / (a * a + b * b) ** 2 for a, b in _PAIR_WAVES))
    waves = {"cos": np.cos, "sin": np.sin}
    for joint, other in ((j, k) for j in range(context.joints) for k in (j - 1, j + 1) if 0 <= k < context.joints):
        for a, b in _PAIR_WAVES:
            for own, of_other in product(waves if a else ("cos",), waves):
                name = f"{own}{a}q{joint + 1}.{of_other}{b}q{other + 1}"
                if names is None or name in names:
                    offset = waves[own](a * context.q[:, joint]) * waves[of_other](b * context.q[:, other])
                    sd = amplitude * (math.sqrt(2.0) if a else 1.0) / (a * a + b * b) / total
                    columns.append(joint_column(name, "rad", joint, offset, *_BOUNDS, prior_sd=sd))
    return columns


def _label(acts_on: ActedOn) -> str:
    return acts_on.name.replace(" ", "_")


def _shifts(context: EffectContext, acts_on: ActedOn) -> list[tuple[str, Array]]:
    """Unit and SMR shift (n, 3) per unit of each direction of a place other than a joint."""
    return [_shift(context, acts_on.acts_on, direction) for direction in acts_on.directions]


def _shift(context: EffectContext, acts_on: ActsOn, direction: Direction) -> tuple[str, Array]:
    axes = {Direction.SHIFT_X: 0, Direction.SHIFT_Y: 1, Direction.SHIFT_Z: 2, Direction.TURN_X: 3, Direction.TURN_Y: 4}
    if direction in axes:
        axis = axes[direction]
        if acts_on is ActsOn.TOOL:
            return "m", context.moved(context.frames[0][-1][:, :, axis])
        return ("m" if axis < 3 else "rad"), context.base_twists[axis]
    distance, beam = context.beam
    _, elevation, horizontal, upward = context.across
    if direction is Direction.RADIAL:
        return "m", context.moved(beam)
    if direction is Direction.AZIMUTH:
        return "rad", context.moved((distance * np.cos(elevation))[:, None] * horizontal)
    return "rad", context.moved(distance[:, None] * upward)


# -- Basis functions of data-driven laws, and their constants, which are taken from a run -----------------------------


ORDER = 4
"""Highest order of the functions of one variable; higher ones would fit noise in a few hundred readings."""
TIME_ORDER = 20
"""Most half cycles over the run: a drift may change its direction twenty times."""
PAIR_ORDER = 3
"""Highest total order of the functions of two variables: 24 columns at most."""
PAIR_ORDERS = (2, PAIR_ORDER)
"""Total orders that are tried: with at most 12 columns, a weak effect in few readings can be described too."""
ANGLE_PAIR_ORDERS = (*PAIR_ORDERS, 2 * PAIR_ORDER)
"""Total orders of functions of two angles, each up to order 3: the last has all 48 products, as for two gear wheels."""


def run_constants(context: EffectContext, variable: Variable) -> dict[str, float]:
    """Return a variable's constants from the run: order, range, and a default for unknown values."""
    if variable.is_joint_angle:
        return {"order": float(ORDER)}
    if variable.quantity is Quantity.TIME:
        first, last = run_span(context).values()
        return {"order": float(TIME_ORDER), "low": first, "high": last, "typical": last}
    values = variable.values(context)
    center = {}
    if variable.quantity is Quantity.AZIMUTH:
        center = {"center": math.atan2(float(np.sin(values).mean()), float(np.cos(values).mean()))}
        values = _about(values, center["center"])
    typical = float(np.mean(values))
    if variable.quantity is Quantity.DWELL:
        typical = float(np.median(values))
    elif variable.quantity is Quantity.PAYLOAD:
        typical = context.bodies.payload_mass
    elif variable.quantity is Quantity.STEP:
        typical = 0.0
    order = float(min(ORDER, len(np.unique(values)) - 1))
    return {"order": order, "low": float(values.min()), "high": float(values.max()), "typical": typical, **center}


def _about(azimuth: Array, center: float) -> Array:
    """Compute azimuths (n,) relative to a centre, -pi to pi: no jump within the cell, whatever the tracker's x axis."""
    return np.asarray(np.remainder(azimuth - center + np.pi, 2.0 * np.pi) - np.pi)


def functions(context: EffectContext, law: Law) -> dict[str, Array]:
    """Evaluate the functions (n,) of a law's variables, by name."""
    return FunctionTable(context).functions(data_driven_form(law).inputs, law.constants)


@dataclass(frozen=True, eq=False)
class FunctionTable:
    """Functions of data-driven laws at the stops of a context; those of one variable are evaluated once for all pairs.

    ``families`` and ``waves`` are caches.
    """

    context: EffectContext
    families: dict[tuple[Variable, float], list[tuple[int, str, Array]]] = field(default_factory=dict)
    waves: dict[Variable, NDArray[np.complex128]] = field(default_factory=dict)

    def functions(self, inputs: tuple[Variable, ...], constants: Mapping[str, float]) -> dict[str, Array]:
        """Evaluate the functions (n,) of some variables, by name."""
        if inputs == POSITION:
            return field_functions(position_in_base(self.context), constants)
        first = _own(constants, FIRST_CONSTANTS, "")
        if len(inputs) == 1:
            if inputs[0].quantity is Quantity.TIME:
                return _of_time(self.context, inputs[0], first)
            return {name: values for _, name, values in self._family(inputs[0], first)}
        if all(one.is_joint_angle for one in inputs):
            return self._of_two_angles(inputs, round(constants["order"]))
        second = _own(constants, SECOND_CONSTANTS, "2")
        most = round(max(first["order"], second["order"]))
        ones = [(0, "", np.ones(len(self.context)))]
        products = {}
        for m, left, f in ones + self._family(inputs[0], first):
            for k, right, g in ones + self._family(inputs[1], second):
                if 1 <= m + k <= most:
                    products["*".join(filter(None, (left, right)))] = f * g
        return products

    def _family(self, variable: Variable, constants: Mapping[str, float]) -> list[tuple[int, str, Array]]:
        key = (variable, constants["order"])
        if key not in self.families:
            self.families[key] = _family(self.context, variable, constants)
        return self.families[key]

    def _of_two_angles(self, inputs: tuple[Variable, ...], order: int) -> dict[str, Array]:
        """Evaluate cosine and sine of m v + k w, 1 <= |m| + |k| <= ``order``, each at most 3, opposite signs once."""
        v, w = (self._waves(one) for one in inputs)
        labels = tuple(one.name.replace(" ", "_") for one in inputs)
        found = {}
        for m, k, text in _phases(labels, order):
            wave = v[m] * (w[k] if k >= 0 else w[-k].conj())
            found[f"cos({text})"], found[f"sin({text})"] = wave.real, wave.imag
        return found

    def _waves(self, angle: Variable) -> NDArray[np.complex128]:
        """Evaluate ``exp(i m v)`` for m = 0 to 3 (4, n); zero, its mean over a turn, if the angle is unknown."""
        if angle not in self.waves:
            values = angle.values(self.context)
            waves = np.exp(1j * np.arange(PAIR_ORDER + 1)[:, None] * values)
            self.waves[angle] = np.where(np.isfinite(values), waves, 0.0)
        return self.waves[angle]


def _own(constants: Mapping[str, float], declared: Iterable[Constant], suffix: str) -> dict[str, float]:
    """Return the constants of one variable, without the suffix of the second."""
    return {one.name.removesuffix(suffix): constants[one.name] for one in declared if one.name in constants}


def _family(context: EffectContext, variable: Variable, constants: Mapping[str, float]) -> list[tuple[int, str, Array]]:
    """Return order, name and values (n,) of the functions of one variable; zero if an angle is unknown."""
    label, order = variable.name.replace(" ", "_"), round(constants["order"])
    if variable.is_joint_angle:
        angle = variable.values(context)
        return [
            (m, f"{letter}{m}_{label}", np.asarray(np.nan_to_num(wave(m * angle)), dtype=np.float64))
            for m in range(1, order + 1)
            for letter, wave in (("cos", np.cos), ("sin", np.sin))
        ]
    polynomials = np.asarray(legvander(2.0 * _unit(context, variable, constants) - 1.0, order), dtype=np.float64)
    return [(m, f"p{m}_{label}", polynomials[:, m]) for m in range(1, order + 1)]


def _unit(context: EffectContext, variable: Variable, constants: Mapping[str, float]) -> Array:
    """Scale a variable (n,) to 0 to 1 over its range in the run, constant beyond."""
    values = variable.values(context)
    if variable.quantity is Quantity.AZIMUTH:
        values = _about(values, constants["center"])
    low, high = constants["low"], constants["high"]
    return np.clip((with_default(values, constants["typical"], len(context)) - low) / (high - low), 0.0, 1.0)


def _of_time(context: EffectContext, time: Variable, constants: Mapping[str, float]) -> dict[str, Array]:
    """Evaluate a line and half cycles over the run, or one period."""
    x = _unit(context, time, constants)
    if PERIOD.name in constants:
        phase = 2.0 * np.pi * x * (constants["high"] - constants["low"]) / constants[PERIOD.name]
        return {"cos_time": np.cos(phase), "sin_time": np.sin(phase)}
    half_cycles = range(1, round(constants["order"]) + 1)
    return {"linear_time": 2.0 * x - 1.0} | {f"cos{k}_time": np.cos(np.pi * k * x) for k in half_cycles}


@lru_cache(maxsize=256)
def _phases(labels: tuple[str, ...], order: int) -> tuple[tuple[int, int, str], ...]:
    """List m, k and the text of each m v + k w."""
    return tuple(
        (m, k, _phase_text(m, k, labels))
        for m in range(min(order, PAIR_ORDER) + 1)
        for k in range(max(m - order, -PAIR_ORDER), min(order - m, PAIR_ORDER) + 1)
        if m > 0 or k > 0
    )


def _phase_text(m: int, k: int, labels: tuple[str, ...]) -> str:
    """``2*q1-q2`` and the like."""
    terms = [f"{count:+d}*{label}" for count, label in zip((m, k), labels, strict=True) if count]
    return "".join(terms).replace("+1*", "+").replace("-1*", "-").removeprefix("+")
