"""Effects without a name: a data-driven term that states which channel depends on which one or two variables."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar

import numpy as np

from cellapp.robot.effects.column import Channel, EffectColumn, joint_column, shift_column
from cellapp.robot.effects.context import EffectContext
from cellapp.robot.effects.contradiction import (
    BorrowedForm,
    ContradictionForm,
    borrowed_form_named,
    contradiction_meaning,
    lent_law,
)
from cellapp.robot.effects.data_driven import (
    PERIOD,
    DataChannel,
    DataDrivenForm,
    Direction,
    Quantity,
    Variable,
    channels,
    data_driven_form,
    form_named,
    form_of,
    variables,
)
from cellapp.robot.effects.data_functions import ANGLE_PAIR_ORDERS, PAIR_ORDERS, functions, run_constants
from cellapp.robot.effects.effect import Effect
from cellapp.robot.effects.field import FIELD_LENGTH, field_frequencies, field_variances
from cellapp.robot.effects.law import DriverVariable, Law, LawForm
from cellapp.robot.effects.meaning import Meaning
from cellapp.robot.effects.smooth import AMPLITUDE, with_prior_sd
from cellapp.robot.effects.unknown_meaning import UNKNOWN_MEANING, data_driven_meaning, imitation_meaning
from cellapp.robot.kinematics.transforms import Array

_LARGEST = 1e-2
"""Bound of each parameter [rad, m]; nothing is known about the size of an unknown effect."""
_PERIODS = 48
"""Periods to try, 7 % apart over the range that a run of a few hundred stops resolves."""
_STOPS_PER_PERIOD = 12.0
"""Mean number of stops in the shortest period."""
_FEWEST = 24
"""Stops below which the shortest period is not shortened further."""


class Unknown(Effect):
    """A data-driven term ``sum_k b_k f_k(v)`` in one channel, or ``sum_k b_k f_k(v, w)``; b in rad or m.

    Of a joint angle v: cosine and sine of v to 4 v. Of time: linear, and cosine of 1 to 20 half cycles over the run, or
    with ``period_s`` cosine and sine of one period. Of anything else: Legendre polynomials to order 4 on the range it
    had in the run, constant beyond it. Of two variables: all such functions of total order up to 3, of two angles also
    all products to order 3 each. Constants: ``order``, ``low``, ``high`` and ``typical`` (the default where unknown:
    the end of the run for time, no step, the run's median dwell, its mean temperature, the nominal payload), ``center``
    of an azimuth; with a ``2`` appended for the second variable.

    Of the position: the smooth field over the workspace of ``robot.effects.field``, a shift along x, y and z of
    the base with one amplitude and one length scale.

    A law of the library whose values are impossible, or that imitates a part of something else, is one as well.

    It is not scanned like the named effects; ``dictionary`` and ``pairs`` list the laws to try. A term imitates every
    named effect that has its channel and variable.
    """

    slug = "unknown"
    title = "unknown effect"
    meaning = UNKNOWN_MEANING
    variables: ClassVar[frozenset[DriverVariable]] = frozenset()
    forms: ClassVar[tuple[LawForm, ...]] = ()

    def __init__(self, library: Mapping[str, Effect] | None = None) -> None:
        self._library = {} if library is None else library

    def form(self, name: str) -> LawForm:
        """The form of a name such as ``joint 2|q1`` or ``contradiction|backlash|constant``."""
        form = form_named(name) or borrowed_form_named(name, self._library)
        return super().form(name) if form is None else form

    def meaning_of(self, law: Law) -> Meaning:
        """Checks by channel and further stops by variables; those of the effect that a contradiction behaves like."""
        if isinstance(law.form, ContradictionForm):
            return contradiction_meaning(law.form.effect)
        if isinstance(law.form, BorrowedForm):
            return imitation_meaning(law.form.effect.title, law.form.effect.meaning)
        if not isinstance(law.form, DataDrivenForm):
            return self.meaning
        return data_driven_meaning(law.form.channel, law.form.drivers)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per function and direction, all in one block; those of the effect for a law of the library."""
        if isinstance(law.form, BorrowedForm):
            of_effect = law.form.effect.columns(context, lent_law(law), names)
            return [replace(column, lower=-np.inf, upper=np.inf) for column in of_effect]
        channel = data_driven_form(law).channel
        if channel not in channels(context.joints):
            raise ValueError(f"effect {self.slug} has no law '{law.name}' for an arm with {context.joints} joints")
        values = functions(context, law)
        if channel.channel is Channel.JOINT:
            assert channel.joint is not None
            prefix = _label(channel)
            return [
                joint_column(f"{prefix}.{name}", "rad", channel.joint, one, -_LARGEST, _LARGEST, channel.name)
                for name, one in values.items()
            ]
        columns = []
        for part, (unit, moved) in zip(channel.parts, _shifts(context, channel), strict=True):
            columns += [
                shift_column(
                    f"{_label(part)}.{name}",
                    unit,
                    channel.channel,
                    one[:, None] * moved,
                    -_LARGEST,
                    _LARGEST,
                    channel.name,
                )
                for name, one in values.items()
            ]
        return _with_priors(columns, law) if data_driven_form(law).is_field else columns


@dataclass(frozen=True)
class FunctionFamily:
    """Functions of one or two variables that any channel may depend on: the variables, and the constants of the law."""

    drivers: tuple[Variable, ...]
    constants: Mapping[str, float]

    def law(self, channel: DataChannel) -> Law:
        """The data-driven law of a channel."""
        return form_of(channel, self.drivers).law(self.constants)


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

    The default are those of ``data_functions``, more for two angles.
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


def channel_directions(context: EffectContext, channel: DataChannel) -> list[Array]:
    """SMR shifts (n, 3) [m, tracker frame] per unit of a channel other than a joint, in each of its directions."""
    return [moved for _, moved in _shifts(context, channel)]


def _label(channel: DataChannel) -> str:
    return channel.name.replace(" ", "_")


def _shifts(context: EffectContext, channel: DataChannel) -> list[tuple[str, Array]]:
    """Unit and SMR shift (n, 3) per unit of each direction of a channel other than a joint."""
    return [_shift(context, channel.channel, direction) for direction in channel.directions]


def _shift(context: EffectContext, channel: Channel, direction: Direction) -> tuple[str, Array]:
    axes = {Direction.SHIFT_X: 0, Direction.SHIFT_Y: 1, Direction.SHIFT_Z: 2, Direction.TURN_X: 3, Direction.TURN_Y: 4}
    if direction in axes:
        axis = axes[direction]
        if channel is Channel.TOOL:
            return "m", context.moved(context.frames[0][-1][:, :, axis])
        return ("m" if axis < 3 else "rad"), context.base_twists[axis]
    distance, beam = context.beam
    _, elevation, horizontal, upward = context.across
    if direction is Direction.RADIAL:
        return "m", context.moved(beam)
    if direction is Direction.AZIMUTH:
        return "rad", context.moved((distance * np.cos(elevation))[:, None] * horizontal)
    return "rad", context.moved(distance[:, None] * upward)
