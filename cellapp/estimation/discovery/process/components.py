"""Components of the structured process: an effect's smooth law on the data at hand, and its hyperparameters.

A component is a channel (what moves) times a driver (what it depends on), as a smooth form of a named effect: about
the axis against its own angle is a transmission error, across the axis a wobble, against gravity's torque a compliance,
and so on. Its columns are weighted by a spectrum that depends on an amplitude and, for functions of an angle, on a
length scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectContext, Law, LawForm
from cellapp.robot.effects.backlash import TYPICAL_STEP, WIDTH
from cellapp.robot.effects.base_motion import order_span
from cellapp.robot.effects.data_driven import FIELD, position_in_base
from cellapp.robot.effects.field import FIELD_LENGTH, box_of, field_frequencies, field_variances
from cellapp.robot.effects.periodic import CURVE, CURVE_AMPLITUDE, CURVE_LENGTH
from cellapp.robot.effects.smooth import AMPLITUDE, CYCLES, LENGTH, circle_variances
from cellapp.robot.effects.time_functions import FIRST, run_span, times_known
from cellapp.robot.kinematics.transforms import Array

CURVE_CYCLES = 80
"""Highest cycle count of a joint's curve: at the shortest length scale, 3 degrees, 1 % of its variance is beyond."""
MOTION_CYCLES = 10
"""Highest cycle count of the other error motions of an axis, which bearings and raceways make."""
_USUAL_WIDTH = 0.03
"""Step [rad] beyond which lost motion is taken as complete, where no law says otherwise: below the steps of nearly all
runs, so that stops after larger steps than the run had are not given more of it than was measured."""
_LEAST_LEVER = 0.05
"""Joints whose rms lever is below this share of the longest get no curve: their errors do not show at the SMR."""


@dataclass(frozen=True)
class LengthRange:
    """First guess and bounds of a length scale [rad], of a field over the workspace [m]."""

    start: float
    least: float
    most: float


CURVE_LENGTHS = LengthRange(math.radians(5.0), math.radians(3.0), math.radians(40.0))
"""A gear's errors have periods from a few degrees to a turn; below 3 degrees lines of the spectrum describe them."""
MOTION_LENGTHS = LengthRange(math.radians(40.0), math.radians(20.0), math.radians(120.0))
"""Errors of a bearing's raceways have a few cycles a turn."""
FIELD_LENGTHS = LengthRange(0.5, 0.2, 3.0)
"""Layers of air and bent stands act over a good part of the workspace; shorter fields need more readings than there
are."""


@dataclass(frozen=True, eq=False)
class Component:
    """A smooth law on the data at hand.

    Attributes
    ----------
    slug : str
        The effect.
    columns : tuple of EffectColumn, length m
    rows : array, shape (m, d)
        Their whitened displacements.
    constants : mapping
        Constants of the law that are no hyperparameters.
    form : LawForm
    groups : array, shape (m,)
        Amplitude of each column, an index into ``amplitude_keys``.
    amplitude_keys : tuple of str
        Constants of the law that hold the amplitudes.
    start : float
        First guess of the amplitudes.
    weights : array, shape (m,)
        Relative prior variances where no length scale is fitted; else not used.
    lengths : LengthRange, optional
    length_keys : tuple of str
        Constants of the law that hold the length scale; one value for all.
    frequencies : array, shape (m,), optional
        Of a field over the workspace: angular frequency of each column [1/m].
    """

    slug: str
    columns: tuple[EffectColumn, ...]
    rows: Array
    form: LawForm
    constants: Mapping[str, float]
    groups: NDArray[np.intp]
    amplitude_keys: tuple[str, ...]
    start: float
    weights: Array
    lengths: LengthRange | None = None
    length_keys: tuple[str, ...] = ()
    frequencies: Array | None = None

    @property
    def hyperparameters(self) -> int:
        """How many are fitted: amplitudes, and a length scale where it has one."""
        return len(self.amplitude_keys) + (0 if self.lengths is None else 1)

    def relative_variances(self, length: float) -> Array:
        """Prior variances (m,) at unit amplitude."""
        if self.lengths is None:
            return self.weights
        if self.frequencies is not None:
            return field_variances(length, self.frequencies)
        return np.asarray(circle_variances(length, int(self._cycles.max()))[self._cycles - 1])

    @cached_property
    def _cycles(self) -> NDArray[np.intp]:
        """Cycles a turn of each column (m,), zero for those that are no wave."""
        return np.array([column.cycles or 0 for column in self.columns], dtype=np.intp)

    def law(self, amplitudes: Array, length: float) -> Law:
        """The law with its hyperparameters."""
        found = dict(self.constants)
        found |= dict(zip(self.amplitude_keys, amplitudes.tolist(), strict=True))
        found |= dict.fromkeys(self.length_keys, length)
        return self.form.law(found)

    def of_amplitudes(self, kept: Sequence[int]) -> Component:
        """The component with some of its amplitudes only."""
        places = np.flatnonzero(np.isin(self.groups, list(kept)))
        keys = [self.amplitude_keys[k] for k in kept]
        lengths = [key for key in self.length_keys if len(self.length_keys) == 1 or _same_joint(key, keys)]
        some = self._take(places)
        groups = np.searchsorted(np.asarray(sorted(kept)), some.groups)
        return replace(some, groups=groups, amplitude_keys=tuple(keys), length_keys=tuple(lengths))

    def coarse(self) -> Component:
        """The component with the slower half of its waves, where it has a length scale."""
        if self.lengths is None:
            return self
        fast = self._cycles if self.frequencies is None else self.frequencies
        return self._take(np.flatnonzero(fast <= 0.5 * fast.max()))

    def _take(self, places: NDArray[np.intp]) -> Component:
        return replace(
            self,
            columns=tuple(self.columns[k] for k in places),
            rows=self.rows[places],
            groups=self.groups[places],
            weights=self.weights[places],
            frequencies=None if self.frequencies is None else self.frequencies[places],
        )


def _same_joint(length_key: str, amplitude_keys: Sequence[str]) -> bool:
    number = length_key.removeprefix(CURVE_LENGTH.name)
    return CURVE_AMPLITUDE.name + number in amplitude_keys


def components(data: ArmData, fit: JointFit) -> list[Component]:
    """All components that the data allow, beside a fit."""
    found = [_curves(data, fit)]
    for slug, name, constants, start in _plain_laws(data):
        found.append(_plain(data, fit, slug, name, constants, start))
    for slug, start in (("joint_axis_wobble", 3e-5), ("joint_axis_runout", 1e-5)):
        found.append(_error_motions(data, fit, slug, start))
    found.append(_field(data, fit))
    return [one for one in found if one is not None]


def _plain_laws(data: ArmData) -> list[tuple[str, str, dict[str, float], float]]:
    """Smooth laws without a length scale: effect, name of the form, constants, first guess of the amplitude."""
    context = data.context
    laws: list[tuple[str, str, dict[str, float], float]] = [
        ("encoder_eccentricity", "smooth", {}, 5e-5),
        ("joint_compliance", "smooth", {}, 1e-5),
    ]
    typical = {TYPICAL_STEP.key(j): size for j, size in enumerate(_typical_steps(context).tolist())}
    laws.append(("backlash", "smooth", {WIDTH.name: _USUAL_WIDTH, **typical}, 5e-5))
    if times_known(context) and FIRST.name in run_span(context):
        laws.append(("base_drift", "smooth", run_span(context), 2e-5))
    elif order_span(context):
        laws.append(("base_drift", "smooth_in_order", order_span(context), 2e-5))
    return laws


def _typical_steps(context: EffectContext) -> Array:
    """Median step of each joint (N,) [rad]; where no step is known, one that takes up all play."""
    if context.conditions.step is None:
        return np.full(context.joints, 10.0 * _USUAL_WIDTH)
    return np.asarray(np.median(np.abs(context.step), axis=0))


def _plain(
    data: ArmData, fit: JointFit, slug: str, name: str, constants: dict[str, float], start: float
) -> Component | None:
    """A component with one amplitude; its columns' priors at unit amplitude are the relative ones."""
    form = next((one for one in EFFECTS[slug].forms if one.name == name), None) if slug in EFFECTS else None
    if form is None:
        return None
    columns = tuple(data.columns(slug, form.law({**constants, AMPLITUDE.name: 1.0})))
    rows = fit.displacements(columns) if columns else np.zeros((0, 3 * len(data)))
    if not rows.any():
        return None
    return Component(
        slug=slug,
        columns=columns,
        rows=rows,
        form=form,
        constants=constants,
        groups=np.zeros(len(columns), dtype=np.intp),
        amplitude_keys=(AMPLITUDE.name,),
        start=start,
        weights=np.array([column.prior_sd**2 for column in columns]),
    )


def _error_motions(data: ArmData, fit: JointFit, slug: str, start: float) -> Component | None:
    """Error motions of the axes against their own angles: one amplitude and one length scale for all joints."""
    constants = {CYCLES.name: float(MOTION_CYCLES), LENGTH.name: MOTION_LENGTHS.start}
    found = _plain(data, fit, slug, "smooth", constants, start)
    if found is None:
        return None
    fixed = {CYCLES.name: constants[CYCLES.name]}
    return replace(found, constants=fixed, lengths=MOTION_LENGTHS, length_keys=(LENGTH.name,))


def _curves(data: ArmData, fit: JointFit) -> Component | None:
    """A curve for each joint with a lever: an amplitude each, one length scale."""
    levers = np.sqrt(np.mean(np.sum(fit.by_joint**2, axis=0), axis=1))
    joints = np.flatnonzero(levers > _LEAST_LEVER * levers.max()).tolist()
    if not joints:
        return None
    constants: dict[str, float] = {CYCLES.name: float(CURVE_CYCLES)}
    keys = {joint: (CURVE_AMPLITUDE.key(joint), CURVE_LENGTH.key(joint)) for joint in joints}
    full = {**constants} | {key: 1.0 for pair in keys.values() for key in pair}
    columns = tuple(data.columns("transmission_error", CURVE.law(full)))
    place = {joint: k for k, joint in enumerate(joints)}
    return Component(
        slug="transmission_error",
        columns=columns,
        rows=fit.displacements(columns),
        form=CURVE,
        constants=constants,
        groups=np.array([place[c.joint] for c in columns if c.joint is not None], dtype=np.intp),
        amplitude_keys=tuple(amplitude for amplitude, _ in keys.values()),
        start=2e-4,
        weights=np.ones(len(columns)),
        lengths=CURVE_LENGTHS,
        length_keys=tuple(length for _, length in keys.values()),
    )


def _field(data: ArmData, fit: JointFit) -> Component:
    """A field over the workspace: one amplitude for its three directions, one length scale."""
    box = box_of(position_in_base(data.context))
    law = FIELD.law({**box, AMPLITUDE.name: 1.0, FIELD_LENGTH.name: FIELD_LENGTHS.start})
    columns = tuple(data.columns(UNKNOWN, law))
    return Component(
        slug=UNKNOWN,
        columns=columns,
        rows=fit.displacements(columns),
        form=FIELD,
        constants=box,
        groups=np.zeros(len(columns), dtype=np.intp),
        amplitude_keys=(AMPLITUDE.name,),
        start=2e-5,
        weights=np.ones(len(columns)),
        lengths=FIELD_LENGTHS,
        length_keys=(FIELD_LENGTH.name,),
        frequencies=np.tile(field_frequencies(box), 3),
    )
